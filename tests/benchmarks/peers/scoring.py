"""How well frames were placed: the same arithmetic for every stitcher, ours included.

A grid of points of every frame goes to the mosaic by what the stitcher says, and to the board by the truth. One
similarity for the whole strip (a mosaic has a scale, a rotation and an origin of its own) is fitted between the two;
what is left, in pixels of the frames, is the error.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from .strip import Floats, Matrices

GRID = (7, 5)
"""Points across and along a frame, its corners among them."""


@dataclass(frozen=True)
class Score:
    """Errors of a strip.

    Attributes:
        dropped: how many frames were not placed.
        rms_px: root mean square length of the residuals, px; None where frames were dropped, since a strip with
            holes is not stitched and what is left of it would compare with nothing.
        max_px: the longest.
    """

    dropped: int
    rms_px: float | None
    max_px: float | None


def score(mosaic_from_frame: Matrices, board_from_frame: NDArray[np.float64], frame_px: tuple[int, int]) -> Score:
    """Score the placement of all frames of a strip.

    Args:
        mosaic_from_frame: what the stitcher says; None where it placed nothing.
        board_from_frame: (k, 3, 3) the truth, in px of the board (mm times the nominal px per mm).
        frame_px: width and height of the frames.
    """
    if len(mosaic_from_frame) != len(board_from_frame):
        raise ValueError(f"{len(mosaic_from_frame)} matrices for {len(board_from_frame)} frames")
    dropped = sum(matrix is None for matrix in mosaic_from_frame)
    if dropped:
        return Score(dropped, None, None)
    grid = _grid(frame_px)
    said = np.concatenate([_apply(m, grid) for m in mosaic_from_frame if m is not None])
    true = np.concatenate([_apply(m, grid) for m in board_from_frame])
    lengths = np.abs(_residuals(said, true))
    return Score(0, float(np.sqrt(np.mean(lengths**2))), float(lengths.max()))


def _grid(frame_px: tuple[int, int]) -> Floats:
    x, y = (np.linspace(0, size - 1, count) for size, count in zip(frame_px, GRID, strict=True))
    return np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)


def _apply(matrix: Floats, points: Floats) -> Floats:
    q = np.column_stack([points, np.ones(len(points))]) @ matrix.T
    return np.asarray(q[:, :2] / q[:, 2:])


def _residuals(said: Floats, true: Floats) -> NDArray[np.complex128]:
    """true − (a·said + b) over the best complex a and b: a rotation and a scale, and a shift."""
    z, w = (p[:, 0] + 1j * p[:, 1] for p in (said, true))
    z, w = z - z.mean(), w - w.mean()
    return np.asarray(w - z * (np.vdot(z, w) / np.vdot(z, z)))
