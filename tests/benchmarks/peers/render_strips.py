"""Render the strips with the digital twin: `python -m peers.render_strips DIRECTORY`.

Every frame of a strip is filled by the board. Frames are flattened for all peers: even illumination, no distortion,
and, for cameras with mounting errors, seen straight from above by means of the calibration. The peers get the nominal
positions as prior knowledge: where each camera looks, and the nominal speed of the belt.
"""

from __future__ import annotations

import json
import sys
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import apply
from vaoi_station.model import RecordingHead
from vaoi_station.simulation import Passage, Scenario, Twin

from .strip import Floats, Strip

PX_PER_MM = 40.0
ROWS = 5
PERIOD_S = 0.105
TURN_DEG = 0.2
"""Rotation of the board from the first to the last row of the strips with yaw."""
CROPPED_PX = 6
"""Margin cut from each side of a flattened frame, which may be empty."""

IDEAL: dict[str, float] = {"tilt_deg": 0.0, "roll_deg": 0.0, "position_mm": 0.0, "focal_length": 0.0}
STRAIGHT: dict[str, float] = {"yaw_sigma_deg": 0.0, "yaw_wander_deg": 0.0, "speed_error": 0.004}
TURNING = {**STRAIGHT, "yaw_rate_deg_s": TURN_DEG / ((ROWS - 1) * PERIOD_S)}
BARE: dict[str, float] = {"height_scale": 0.0}

VARIANTS: dict[str, dict[str, dict[str, float]]] = {
    "plain": {"array": IDEAL, "belt": STRAIGHT, "board": BARE},
    "yaw": {"array": IDEAL, "belt": TURNING, "board": BARE},
    "parts": {"array": IDEAL, "belt": STRAIGHT, "board": {}},
    "line": {"array": {}, "belt": {"speed_error": 0.004}, "board": {}},
}
"""Parameters of the variants: mounting errors of the cameras, yaw of the belt, height of the components."""


@dataclass(frozen=True, eq=False)
class RenderedStrip:
    """A strip, with raw frames and calibration for our own adapter alone, and the truth for the scorer alone."""

    strip: Strip
    head: RecordingHead
    calibration: dict[str, Any]
    board_type: dict[str, Any]
    raw: NDArray[np.uint8]
    """(k, h, w) frames before flattening."""
    tester_from_flat: Floats
    """(k, 3, 3) flattened pixels to mm in the calibrated plane, at the moment of the frame."""
    board_from_flat: Floats
    """(k, 3, 3) flattened pixels to px of the board: the truth."""

    def write(self, directory: Path) -> None:
        """Write everything into a directory."""
        self.strip.write(directory)
        np.savez(directory / "ours.npz", raw=self.raw, tester_from_flat=self.tester_from_flat)
        np.save(directory / "truth.npy", self.board_from_flat)
        known = {
            "head": self.head.model_dump(mode="json"),
            "calibration": self.calibration,
            "board_type": self.board_type,
        }
        (directory / "ours.json").write_text(json.dumps(known))


def twin_of(variant: str, **sections: dict[str, Any]) -> Twin:
    """Return the twin of a variant: the paper's cameras, a board that fills their view; sections override."""
    base: dict[str, dict[str, Any]] = {
        "array": {"cameras": 3, "px_per_mm": PX_PER_MM, "overlap": 1.1, "vignetting": 0.0},
        "belt": {"offset_sigma_mm": 0.0},
        "board": {"name": "strip", "width_mm": 110.0, "length_mm": 90.0},
        "line": {"barrier_mm": -60.0, "period_s": PERIOD_S, "tail_s": 1.2, "longest_board_mm": 100.0},
    }
    for changes in (VARIANTS[variant], sections):
        for name, section in changes.items():
            base[name] = {**base.get(name, {}), **section}
    return Twin(Scenario.model_validate(base))


def render_strip(variant: str, twin: Twin, rows: int = ROWS) -> RenderedStrip:
    """Render the first rows of a board in which every frame is filled by the board."""
    passage = twin.passage(0)
    first = _first_full_row(passage, rows)
    cells = np.array([(i, j) for j in range(rows) for i in range(len(twin.pinholes))])
    raw = np.stack([passage.frame(int(i), first + int(j)) for i, j in cells])
    flattening = [_flattening(twin, i) for i in range(len(twin.pinholes))]
    frames = np.stack([_flattened(pixels, *flattening[i]) for pixels, (i, _) in zip(raw, cells, strict=True)])
    tester_from_flat = np.stack([flattening[i][1] for i, _ in cells])
    poses = [passage.pose(passage.pulse_times_s[first + j]) for j in range(rows)]
    to_px = np.diag([twin.scenario.array.px_per_mm, twin.scenario.array.px_per_mm, 1.0])
    truth = np.stack([to_px @ np.linalg.inv(poses[j]) @ m for m, (_, j) in zip(tester_from_flat, cells, strict=True)])
    return RenderedStrip(
        Strip(variant, frames, cells, _nominal_px(twin, tester_from_flat, cells)),
        _head(passage, first, rows),
        twin.calibration.model_dump(mode="json", exclude_none=True),
        twin.board_type.model_dump(mode="json", exclude_none=True),
        raw,
        tester_from_flat,
        truth,
    )


def _first_full_row(passage: Passage, rows: int) -> int:
    """Return the first row after which, for the given number of rows, the board fills every frame."""
    board, pinholes = passage.twin.scenario.board, passage.twin.pinholes
    w, h = pinholes[0].width_px - 1, pinholes[0].height_px - 1
    corners = np.concatenate([p.ground(np.array([[0, 0], [w, 0], [0, h], [w, h]], float), 0.0) for p in pinholes])
    size = (board.width_mm, board.length_mm)

    def full(t_s: float) -> bool:
        places = apply(np.linalg.inv(passage.pose(t_s)), corners)
        return bool(((places > 0) & (places < size)).all())

    seen = [full(t) for t in passage.pulse_times_s]
    for first in range(len(seen) - rows + 1):
        if all(seen[first : first + rows]):
            return first
    raise ValueError(f"the board of {board.length_mm} mm fills the view in {sum(seen)} rows, {rows} are needed")


def _flattening(twin: Twin, camera: int) -> tuple[Floats, Floats]:
    """Return raw_from_flat and tester_from_flat of a camera: seen straight from above, at the design's resolution."""
    array, raw_from_tester = twin.scenario.array, twin.pinholes[camera].plane()
    if not (array.tilt_deg or array.roll_deg or array.focal_length):
        return np.eye(3), np.asarray(np.linalg.inv(raw_from_tester))
    middle = np.array([[(array.width_px - 1) / 2, (array.height_px - 1) / 2]])
    x, y = apply(np.linalg.inv(raw_from_tester), middle)[0]
    u, v = middle[0] - CROPPED_PX
    r = array.px_per_mm
    tester_from_flat = np.array([[1 / r, 0, x - u / r], [0, 1 / r, y - v / r], [0, 0, 1]])
    return raw_from_tester @ tester_from_flat, tester_from_flat


def _flattened(raw: NDArray[np.uint8], raw_from_flat: Floats, _: Floats) -> NDArray[np.uint8]:
    """Resample a frame bilinearly; return it unchanged if its camera has no mounting errors."""
    if np.array_equal(raw_from_flat, np.eye(3)):
        return raw
    size = (raw.shape[1] - 2 * CROPPED_PX, raw.shape[0] - 2 * CROPPED_PX)
    flat = cv2.warpPerspective(raw, raw_from_flat, size, flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP)
    return np.asarray(flat, np.uint8)


def _nominal_px(twin: Twin, tester_from_flat: Floats, cells: NDArray[np.int64]) -> Floats:
    """Return the positions of the frames if the belt had its nominal speed."""
    # The board moves forward under fixed cameras, so on the board each next frame lies further back.
    belt, r = twin.line.conveyor_mm_s, twin.scenario.array.px_per_mm
    moved_mm = np.outer(cells[:, 1] * twin.line.trigger_period_s, belt)
    corner_mm = tester_from_flat[:, :2, 2] / tester_from_flat[:, 2:, 2]
    places = (corner_mm - moved_mm) * r
    return np.asarray(places - places.min(0))


def _head(passage: Passage, first: int, rows: int) -> RecordingHead:
    times_s = [t - passage.pulse_times_s[first] for t in passage.pulse_times_s[first : first + rows]]
    changed = {
        "rows": rows,
        "missing": (),
        "trigger_times_s": tuple(times_s),
        "lights": passage.lights[first : first + rows],
    }
    return passage.head().model_copy(update=changed)


def main() -> None:
    """Render every variant into a separate directory."""
    for variant in VARIANTS:
        render_strip(variant, twin_of(variant)).write(Path(sys.argv[1]) / variant)
        print(f"rendered {variant}")


if __name__ == "__main__":
    main()
