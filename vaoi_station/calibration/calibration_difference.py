"""Cross-validation: where two calibrations of one array disagree, in px over every frame.

The board that fixes the tester's coordinates lies a little elsewhere each time. That is no disagreement: one
rigid motion of the tester's plane, the same for all cameras, is taken out first and told.
"""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vaoi_station.errors import InputError
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import Calibration, CameraHead

GRID = (9, 7)
"""Points across and down a frame."""


@dataclass(frozen=True, eq=False)
class CalibrationDifference:
    """Where the other calibration puts what this one sees at a pixel, minus that pixel."""

    grid_px: tuple[Floats, ...]
    """Per camera (rows, columns, 2): raw pixels looked at."""
    difference_px: tuple[Floats, ...]
    """Per camera (rows, columns, 2)."""
    shift_mm: Floats
    """The rigid motion taken out: of the middle of the array, (2,)."""
    angle_rad: float
    one_board: bool = False
    """Both calibrations are of one board where it lay: nothing was taken out."""

    @property
    def rms_px(self) -> tuple[float, ...]:
        """Per camera."""
        return tuple(float(np.sqrt((d**2).sum(-1).mean())) for d in self.difference_px)

    @property
    def max_px(self) -> tuple[float, ...]:
        """Per camera."""
        return tuple(float(np.sqrt((d**2).sum(-1).max())) for d in self.difference_px)

    def lines(self) -> list[str]:
        """The comparison for people."""
        turned = math.degrees(self.angle_rad)
        x, y = self.shift_mm
        out = (
            []
            if self.one_board
            else [f"the board lay ({x:+.3f}, {y:+.3f}) mm and {turned:+.4f}° from where it lay; that is taken out"]
        )
        for i, (rms, most) in enumerate(zip(self.rms_px, self.max_px, strict=True)):
            out.append(f"camera {i}: calibrations differ by {rms:.3f} px rms, {most:.3f} px at most")
        return out


def compare_calibrations(
    this: Calibration,
    other: Calibration,
    heads: Sequence[CameraHead],
    grid: tuple[int, int] = GRID,
    *,
    one_board: bool = False,
) -> CalibrationDifference:
    """Map of the difference of two calibrations.

    Args:
        this: one calibration.
        other: the other, of the same cameras.
        heads: sizes of the frames.
        grid: points across and down each frame.
        one_board: both share the tester's coordinates, as a calibration and its correction do; nothing is taken out.

    Raises:
        InputError: if they are for other numbers of cameras.
    """
    counts = len(this.camera_matrices), len(other.camera_matrices), len(heads)
    if len(set(counts)) > 1:
        raise InputError(
            f"calibrations of {counts[0]} and {counts[1]} cameras cannot be compared for {counts[2]} frames.",
            action="Compare calibrations of one array.",
        )
    mine, theirs = this.cameras(tuple(heads)), other.cameras(tuple(heads))
    grids = [_grid(head, grid) for head in heads]
    here = [camera.ground(g) for camera, g in zip(mine, grids, strict=True)]
    there = [camera.ground(g) for camera, g in zip(theirs, grids, strict=True)]
    a, b = (np.concatenate([p.reshape(-1, 2) for p in places]) for places in (here, there))
    this_from_other, angle = (np.eye(3), 0.0) if one_board else _rigid(a, b)
    differences = [
        camera.project(apply(this_from_other, place)) - g for camera, place, g in zip(mine, there, grids, strict=True)
    ]
    return CalibrationDifference(tuple(grids), tuple(differences), a.mean(0) - b.mean(0), angle, one_board)


def _grid(head: CameraHead, grid: tuple[int, int]) -> Floats:
    x, y = np.linspace(0, head.width - 1, grid[0]), np.linspace(0, head.height - 1, grid[1])
    return np.stack(np.meshgrid(x, y), -1)


def _rigid(target: Floats, source: Floats) -> tuple[Floats, float]:
    """Least-squares rotation and shift (3, 3), target from source (k, 2), and the angle."""
    p, q = source - source.mean(0), target - target.mean(0)
    angle = math.atan2(float((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum()), float((p * q).sum()))
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    matrix = np.eye(3)
    matrix[:2, :2], matrix[:2, 2] = turn, target.mean(0) - turn @ source.mean(0)
    return matrix, angle
