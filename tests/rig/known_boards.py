"""Small boards with known times, pixels and outcomes: input for tests that need no twin."""

from __future__ import annotations

from collections.abc import Mapping
from pathlib import Path
from typing import Any

import numpy as np

from vaoi_station.rig.chip import Pulse
from vaoi_station.rig.devices import Outage
from vaoi_station.rig.line import BoardPassage, FiredPulse, FrameOutcome
from vaoi_station.rig.rendering import BoardMetadata, RenderedBoard
from vaoi_station.rig.report import BoardScore, RigReport
from vaoi_station.rig.score import BoardEvidence, RingCheck, score

Cell = tuple[int, int]
CAMERAS, ROWS = 2, 6
PERIOD_NS = 110_000_000
VIEWS = {"R1": ((0.0, 1.0, 10.0, 20.0), (1.0, 2.0, 30.0, 40.0)), "U1": ((0.0, 3.0, 50.5, 60.25),)}


def known_board(directory: Path, number: int = 0, **changes: Any) -> RenderedBoard:
    """A complete board of two cameras with 8 random bytes per frame; the first pulse comes 0.3 s after the start."""
    metadata = {
        "board": number,
        "cameras": CAMERAS,
        "frame_bytes": 8,
        "edges": ((0.1, True), (0.5, False)),
        "pulses_s": tuple(0.3 + 0.11 * row for row in range(ROWS)),
        "lights": ("ring",) * ROWS,
        "lost": (),
        "views": VIEWS,
        **changes,
    }
    directory.mkdir(parents=True, exist_ok=True)
    document = BoardMetadata.model_validate(metadata)
    (directory / "film.json").write_text(document.model_dump_json())
    pixels = np.random.default_rng(number).integers(0, 256, ROWS * CAMERAS * 8, dtype=np.uint8)
    pixels.tofile(directory / "frames.raw")
    return RenderedBoard(directory)


def passage_of(rendered: RenderedBoard, outcomes: Mapping[Cell, FrameOutcome] | None = None) -> BoardPassage:
    """A passage with all rows fired; outcomes by (camera, row), all others were sent after 20 ms."""
    given = outcomes or {}
    fired = [
        FiredPulse(
            row,
            Pulse(row, row * PERIOD_NS, (0,), 250.0),
            0.2,
            [given.get((c, row), "sent") for c in range(CAMERAS)],
            [1.0] * CAMERAS,
            "",
            {c: 20.0 for c in range(CAMERAS) if (c, row) not in given},
        )
        for row in range(rendered.rows)
    ]
    return BoardPassage(rendered.metadata.board, rendered, 0, 5_000_000_000, fired)


def run_json(rendered: RenderedBoard, lost: Mapping[Cell, tuple[str, str]] | None = None) -> dict[str, Any]:
    """The station's JSON of a run; verdict and cause by (camera, row), all others are ok."""
    given = lost or {}
    frames = []
    for camera in range(CAMERAS):
        for row in range(rendered.rows):
            verdict, cause = given.get((camera, row), ("ok", ""))
            taken = {"light": rendered.metadata.lights[row], "exposure_us": 250.0}
            frames.append({"camera": camera, "row": row, "verdict": verdict, "cause": cause, **taken})
    return {"id": "r1", "state": "ready", "verdict": "ok", "reasons": [], "frames": frames, "timings": None}


def evidence_of(
    rendered: RenderedBoard,
    outcomes: Mapping[Cell, FrameOutcome] | None = None,
    lost: Mapping[Cell, tuple[str, str]] | None = None,
    wrong: Mapping[Cell, str] | None = None,
) -> BoardEvidence:
    """Everything known of a board whose matrices are exact."""
    cells = {(c, r) for c in range(CAMERAS) for r in range(rendered.rows)}
    whole = frozenset(cells - set(lost or {}) - set(wrong or {}))
    return BoardEvidence(
        passage_of(rendered, outcomes),
        run_json(rendered, lost),
        {"components": rendered.metadata.views},
        RingCheck(whole, dict(wrong or {})),
        [18.0, 18.0],
    )


def scored(
    rendered: RenderedBoard,
    outcomes: Mapping[Cell, FrameOutcome] | None = None,
    lost: Mapping[Cell, tuple[str, str]] | None = None,
    wrong: Mapping[Cell, str] | None = None,
    outages: tuple[Outage, ...] = (),
) -> BoardScore:
    """The score of such a board."""
    return score(evidence_of(rendered, outcomes, lost, wrong), outages)


def report_of(*boards: BoardScore, **more: Any) -> RigReport:
    """A report without any failing, but for the given changes."""
    return RigReport(
        **{
            "ok": True, "scenario": "small", "cameras": 2, "width_px": 640, "height_px": 480, "frames_per_s": 9.09,
            "faults": (), "boards": boards, "boards_missed": 0, "stray_pulses": 0, "rms_px": 0.01,
            "max_px": 0.02, "runs": len(boards),
            "recoveries": (), "took_s": 9.0, "failings": (), **more,
        }
    )  # fmt: skip
