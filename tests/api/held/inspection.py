"""What a held station knows of a run beside its pictures: quality figures with links, and the times of its steps."""

from __future__ import annotations

from typing import Any

from vaoi_station.model import BoardType
from vaoi_station.runs.states.schemas import BarrierTiming, ComponentSummary, RowTiming, TaskTiming, Timeline
from vaoi_station.stitching.geometry import ComponentIndex

_STEP_S = 0.1


def held_quality(cameras: int, rows: int) -> dict[str, Any]:
    """Return figures with links between the frames of neighbouring rows and cameras; those of row 2 found none."""
    pairs = [((i, j), (i, j + 1)) for i in range(cameras) for j in range(rows - 1)]
    pairs += [((i, j), (i + 1, j)) for i in range(cameras - 1) for j in range(rows) if j != 2]
    links = [
        {
            "a": list(a), "b": list(b), "found": 40, "used": 38, "at_mm": [10.0 + 12 * a[0], 8.0 + 8 * a[1]],
            "residual_px": [0.02 * (a[0] + 1), -0.01 * a[1]], "rms_px": 0.06,
        }
        for a, b in pairs
    ]  # fmt: skip
    return {
        "link_pairs": links,
        "unlinked": [{"a": [i, 2], "b": [i + 1, 2], "reason": "too dark"} for i in range(cameras - 1)],
        "matrix_sigma_px": [[[0.01, 0.02]] * rows for _ in range(cameras)],
        "fiducials": [
            {"name": "F1", "sightings": 2, "residual_px": [0.03, 0.04]},
            {"name": "F2", "sightings": 0, "residual_px": None},
        ],
        "orientation": "certain",
        "component_sigma_px": {"U1": 0.02, "R1": 0.05, "2/R1": 0.4},
    }


def held_timeline(cameras: int, rows: int, ready: bool) -> Timeline:
    """Return times of a run whose first frame settles 40 ms after its pulse."""
    settled = [(i, j, 0.05 + _STEP_S * j + 0.04 + 0.002 * i) for i in range(cameras) for j in range(rows)]
    tasks = [
        TaskTiming(
            kind="rows", camera=i, row=j, other_camera=i, other_row=j + 1, ready_s=0.2 + _STEP_S * j,
            done_s=0.21 + _STEP_S * j, worker_ms=8.0,
        )
        for i in range(cameras)
        for j in range(rows - 1)
    ]  # fmt: skip
    last_s = max(time_s for _, _, time_s in settled)
    return Timeline(
        frames_settled_s=tuple(settled),
        tasks=tuple(tasks),
        last_frame_s=last_s,
        ready_s=last_s + 0.08 if ready else None,
        rows=tuple(RowTiming(row=j, pulse_s=0.05 + _STEP_S * j, exposure_us=250.0, led_us=80.0) for j in range(rows)),
        barrier=(BarrierTiming(blocked_s=0.0, clear_s=0.33),),
    )


def held_components(board_type: BoardType, unseen: set[str], quality: dict[str, Any]) -> tuple[ComponentSummary, ...]:
    """Return the components of a run of a board type."""
    corners = ComponentIndex.of(board_type).corners.tolist()
    return tuple(
        ComponentSummary(
            address=c.address, ref=c.ref, panel=c.panel, center_mm=c.center, width_mm=c.width, height_mm=c.height,
            rotation_deg=c.rotation, tester_mm=c.center, views=2, unseen=c.address in unseen,
            sigma_px=quality["component_sigma_px"].get(c.address),
            sigma_mm=quality["component_sigma_px"].get(c.address, 0.8) / 8, footprint=tuple(map(tuple, corners[n])),
        )
        for n, c in enumerate(board_type.components)
    )  # fmt: skip
