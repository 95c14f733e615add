"""Cross-validation: the difference of two calibrations of one array, in px over each frame.

The calibration board defines the tester coordinates, and it lies slightly elsewhere each time. Therefore one rigid
motion of the tester's plane, common to all cameras, is estimated, removed and reported.
"""

from __future__ import annotations

import math
from collections.abc import Collection, Sequence
from dataclasses import dataclass

import numpy as np

from vaoi_station.errors import InputError
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import Calibration, CameraHead

GRID = (9, 7)
"""Number of sampled points across and down a frame."""


@dataclass(frozen=True, eq=False)
class CalibrationDifference:
    """The difference of two calibrations, "this" and "other", at a grid of pixels of each camera.

    The "other" calibration projects a pixel to the ground. "This" calibration projects the ground point back to a
    pixel. The difference is the second pixel minus the first one.
    """

    grid_px: tuple[Floats, ...]
    """Sampled raw pixels of each camera, (rows, columns, 2)."""
    difference_px: tuple[Floats, ...]
    """Difference at each sampled pixel of each camera, (rows, columns, 2)."""
    shift_mm: Floats
    """Shift (2,) at the centre of the array, of the rigid motion that was removed."""
    angle_rad: float
    this_from_other: Floats
    """The rigid motion (3, 3) that was removed."""
    one_board: bool = False
    """Whether both calibrations have the same tester coordinates. Then no motion was removed."""

    @property
    def rms_px(self) -> tuple[float, ...]:
        """Root mean square of the difference, one entry per camera."""
        return tuple(float(np.sqrt((d**2).sum(-1).mean())) for d in self.difference_px)

    @property
    def max_px(self) -> tuple[float, ...]:
        """Largest difference, one entry per camera."""
        return tuple(float(np.sqrt((d**2).sum(-1).max())) for d in self.difference_px)

    def lines(self) -> list[str]:
        """Return the text lines of the report: the removed motion, and the differences of each camera."""
        turned = math.degrees(self.angle_rad)
        x, y = self.shift_mm
        moved = f"board displaced by ({x:+.3f}, {y:+.3f}) mm and {turned:+.4f}° between the two; this motion is removed"
        cameras = [
            f"camera {i}: calibrations differ by {rms:.3f} px rms, {most:.3f} px at most"
            for i, (rms, most) in enumerate(zip(self.rms_px, self.max_px, strict=True))
        ]
        return cameras if self.one_board else [moved, *cameras]


def compare_calibrations(
    this: Calibration,
    other: Calibration,
    heads: Sequence[CameraHead],
    *,
    one_board: bool = False,
    only: Collection[int] | None = None,
) -> CalibrationDifference:
    """Compute the difference of two calibrations of the same cameras over each frame.

    No motion is removed if both have the same tester coordinates (`one_board`), as a calibration and its correction.
    The motion is that of the cameras `only`; None: of all.
    """
    counts = len(this.camera_matrices), len(other.camera_matrices), len(heads)
    if len(set(counts)) > 1:
        raise InputError(
            f"calibrations of {counts[0]} and {counts[1]} cameras cannot be compared for {counts[2]} frames.",
            action="Compare calibrations of one array.",
        )
    mine, theirs = this.cameras(tuple(heads)), other.cameras(tuple(heads))
    grids = [_grid(head) for head in heads]
    # One motion is estimated for all cameras together. A separate motion for each would hide a camera that was knocked.
    here = [camera.ground(g) for camera, g in zip(mine, grids, strict=True)]
    there = [camera.ground(g) for camera, g in zip(theirs, grids, strict=True)]
    fitted = range(len(heads)) if only is None else only
    a, b = (np.concatenate([places[i].reshape(-1, 2) for i in fitted]) for places in (here, there))
    this_from_other, angle = (np.eye(3), 0.0) if one_board else _fit_rigid_motion(a, b)
    differences = [
        camera.project(apply(this_from_other, place)) - g for camera, place, g in zip(mine, there, grids, strict=True)
    ]
    return CalibrationDifference(
        tuple(grids), tuple(differences), a.mean(0) - b.mean(0), angle, this_from_other, one_board
    )


def _grid(head: CameraHead) -> Floats:
    x, y = np.linspace(0, head.width - 1, GRID[0]), np.linspace(0, head.height - 1, GRID[1])
    return np.stack(np.meshgrid(x, y), -1)


def _fit_rigid_motion(target: Floats, source: Floats) -> tuple[Floats, float]:
    """Fit the rigid motion from `source` (k, 2) to `target` by least squares; return its matrix (3, 3) and angle."""
    p, q = source - source.mean(0), target - target.mean(0)
    angle = math.atan2(float((p[:, 0] * q[:, 1] - p[:, 1] * q[:, 0]).sum()), float((p * q).sum()))
    c, s = math.cos(angle), math.sin(angle)
    turn = np.array([[c, -s], [s, c]])
    matrix = np.eye(3)
    matrix[:2, :2], matrix[:2, 2] = turn, target.mean(0) - turn @ source.mean(0)
    return matrix, angle
