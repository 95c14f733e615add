"""Find the blank ground of the calibration board in a frame: places where a mark would be visible if there were one.

A mark that was not detected proves little if dirt, a finger or a scratch may hide it. On blank ground, its absence
contradicts every assignment that expects it there.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.calibration.mark_detection import COARSE_PX, DetectedMarks, MarkAppearance
from vaoi_station.geometry.transforms import Floats

_RANGE, _LEVEL = 0.4, 0.35
"""Limits of blank ground, as shares of the contrast of marks.

They are the largest range of grey levels in the area of a mark, and the largest difference of their mean from the
ground beside the nearest marks. Vignetting alone gives up to 0.2."""
_NEAREST, _NODES = 3, 64


@dataclass(frozen=True, eq=False)
class BlankGround:
    """A map of blank ground in a reduced frame."""

    blank: NDArray[np.bool_]
    factor: int
    """Width of a pixel of the map, in px of the frame."""

    def at(self, px: Floats) -> NDArray[np.bool_]:
        """Return whether a mark at raw pixels (..., 2) would lie on blank ground; false outside the frame."""
        h, w = self.blank.shape
        x, y = np.moveaxis(np.floor((px + 0.5) / self.factor), -1, 0)
        inside = (x >= 0) & (y >= 0) & (x < w) & (y < h)
        column, row = (np.where(inside, v, 0).astype(np.intp) for v in (x, y))
        return np.asarray(inside & self.blank[row, column])


def find_blank_ground(detected: DetectedMarks, kind: MarkAppearance) -> BlankGround:
    """Find the blank ground of a frame: as bright as the ground beside the detected marks; without marks, none."""
    factor = max(int(kind.size_px / COARSE_PX), 1)
    h, w = (max(side // factor, 1) for side in detected.grey.shape)
    small = cv2.resize(detected.grey[: h * factor, : w * factor], (w, h), interpolation=cv2.INTER_AREA)
    size = max(round(kind.size_px / factor), 3) | 1
    around = cv2.getStructuringElement(cv2.MORPH_ELLIPSE, (size, size))
    high, low = cv2.dilate(small, around).astype(np.float64), cv2.erode(small, around).astype(np.float64)
    if not len(detected.px):
        return BlankGround(np.zeros((h, w), np.bool_), factor)
    x, y = np.clip(np.round((detected.px + 0.5) / factor - 0.5), 0, (w - 1, h - 1)).astype(np.intp).T
    contrast = float(np.median(high[y, x] - low[y, x]))
    ground = (low if kind.light else high)[y, x]
    mean = cv2.blur(small.astype(np.float64), (size, size))
    level = np.abs(mean - _nearest_level(ground, np.column_stack([x, y]), (h, w)))
    return BlankGround(np.asarray((high - low <= _RANGE * contrast) & (level <= _LEVEL * contrast)), factor)


def _nearest_level(values: Floats, places: NDArray[np.intp], shape: tuple[int, int]) -> Floats:
    """Compute the median of the values at the nearest places (k, 2), for all pixels of a map."""
    # Brightness changes slowly, so a few nodes are enough, and a fine map with many marks needs little memory.
    h, w = (min(side, _NODES) for side in shape)
    step = np.array([shape[1] / w, shape[0] / h])
    nodes = (np.stack(np.meshgrid(np.arange(w), np.arange(h)), -1).reshape(-1, 1, 2) + 0.5) * step - 0.5
    apart = ((nodes - places) ** 2).sum(-1)
    count = min(_NEAREST, len(values))
    nearest = np.argpartition(apart, count - 1, axis=1)[:, :count]
    level = np.median(values[nearest], axis=1).reshape(h, w)
    return np.asarray(cv2.resize(level, (shape[1], shape[0]), interpolation=cv2.INTER_LINEAR))
