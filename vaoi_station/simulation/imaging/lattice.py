"""Interpolate smooth functions of the pixel position from coarse nodes to all samples of the supersampled image.

The nodes are the centres of blocks of 8 × 8 px. The error of linear interpolation is ¾·e·(h / R)², where h is the
distance of nodes, R the distance of a frame corner from the centre, and e the distortion there. It is 0.0006 px for a
distortion of 10 px in a frame of 1392 × 1040 px.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import cached_property

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats

BLOCK_PX = 8
OVERSAMPLING = 2
"""Number of samples per pixel and axis. A pixel of a frame is the mean of its samples."""


@dataclass(frozen=True)
class Lattice:
    """A rectangle of blocks of a frame: x0 … x1 − 1 by y0 … y1 − 1. Block k covers the pixels 8 k … 8 k + 7."""

    x0: int
    y0: int
    x1: int
    y1: int

    @classmethod
    def over(cls, low_px: Floats, high_px: Floats, width_px: int, height_px: int) -> Lattice | None:
        """Return the blocks of a frame that cover a box of pixels from `low_px` to `high_px`.

        Returns None if the box lies outside the frame.
        """
        # The number of blocks is rounded up. The last block may exceed the frame; `spread` cuts the excess off.
        limit = -(-np.array([width_px, height_px]) // BLOCK_PX)
        x0, y0 = np.clip(np.floor((low_px + 0.5) / BLOCK_PX), 0, limit).astype(int)
        x1, y1 = np.clip(np.ceil((high_px + 0.5) / BLOCK_PX), 0, limit).astype(int)
        return cls(int(x0), int(y0), int(x1), int(y1)) if x1 > x0 and y1 > y0 else None

    @cached_property
    def nodes_px(self) -> Floats:
        """Positions (k, 2) of the nodes in raw pixels, including one extra block on each side."""
        x = (np.arange(self.x0 - 1, self.x1 + 1) + 0.5) * BLOCK_PX - 0.5
        y = (np.arange(self.y0 - 1, self.y1 + 1) + 0.5) * BLOCK_PX - 0.5
        return np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)

    @property
    def window(self) -> tuple[slice, slice]:
        """The samples that the blocks cover, as slices of the lines and columns of the supersampled frame."""
        k = BLOCK_PX * OVERSAMPLING
        return slice(self.y0 * k, self.y1 * k), slice(self.x0 * k, self.x1 * k)

    def spread(self, values: Floats, shape: tuple[int, int]) -> NDArray[np.float32]:
        """Interpolate values (k,) at the nodes to all samples of the window, and cut them to `shape` (h, w)."""
        columns, rows = self.x1 - self.x0 + 2, self.y1 - self.y0 + 2
        k = BLOCK_PX * OVERSAMPLING
        coarse = values.reshape(rows, columns).astype(np.float32)
        fine = cv2.resize(coarse, (columns * k, rows * k), interpolation=cv2.INTER_LINEAR)
        # The outermost blocks are only needed for the interpolation at the border, so they are cut off.
        return np.asarray(fine[k : k + shape[0], k : k + shape[1]])
