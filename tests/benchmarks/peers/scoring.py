"""Score the placement of frames; the same computation for all stitchers, ours included.

A grid of points of every frame is mapped to the mosaic by the stitcher's matrices, and to the board by the truth. A
mosaic has an arbitrary scale, rotation and origin, so one similarity for the whole strip is fitted between the two.
The residuals, in pixels of the frames, are the errors.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .strip import Floats, Matrices

GRID = (7, 5)
"""Number of points across and along a frame; the corners are among them."""


@dataclass(frozen=True)
class Score:
    """Errors of a strip.

    Attributes:
        dropped: number of frames that were not placed.
        rms_px: root mean square length of the residuals, px; None if frames were dropped, as the errors of a part of a
            strip are not comparable with those of a whole one.
        max_px: length of the longest residual, px; None if frames were dropped.
    """

    dropped: int
    rms_px: float | None
    max_px: float | None


def score(mosaic_from_frame: Matrices, board_from_frame: NDArray[np.float64], frame_px: tuple[int, int]) -> Score:
    """Score the placement of all frames of a strip.

    Args:
        mosaic_from_frame: the stitcher's matrices; None for a frame that was not placed.
        board_from_frame: (k, 3, 3) the truth, in px of the board (mm times the nominal px per mm).
        frame_px: width and height of the frames.
    """
    if len(mosaic_from_frame) != len(board_from_frame):
        raise ValueError(f"{len(mosaic_from_frame)} matrices for {len(board_from_frame)} frames")
    dropped = sum(matrix is None for matrix in mosaic_from_frame)
    if dropped:
        return Score(dropped, None, None)
    grid = _grid(frame_px)
    estimated = np.concatenate([_apply(m, grid) for m in mosaic_from_frame if m is not None])
    true = np.concatenate([_apply(m, grid) for m in board_from_frame])
    lengths = np.abs(_residuals(estimated, true))
    return Score(0, float(np.sqrt(np.mean(lengths**2))), float(lengths.max()))


def _grid(frame_px: tuple[int, int]) -> Floats:
    x, y = (np.linspace(0, size - 1, count) for size, count in zip(frame_px, GRID, strict=True))
    return np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)


def _apply(matrix: Floats, points: Floats) -> Floats:
    q = np.column_stack([points, np.ones(len(points))]) @ matrix.T
    return np.asarray(q[:, :2] / q[:, 2:])


def _residuals(estimated: Floats, true: Floats) -> NDArray[np.complex128]:
    """Return true − (a·estimated + b) as complex numbers, after a fit of a (rotation and scale) and b (shift)."""
    z, w = (p[:, 0] + 1j * p[:, 1] for p in (estimated, true))
    z, w = z - z.mean(), w - w.mean()
    return np.asarray(w - z * (np.vdot(z, w) / np.vdot(z, z)))
