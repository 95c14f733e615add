"""The survey of a run: a small copy of every frame on the grid of the board, from which gains and seams follow.

One pixel of the survey is the mean of 8 × 8 px of a frame. The copies of a board of 400 × 410 mm at 40 px/mm take
40 MB, its frames 600 MB; each frame is read once.
"""

from __future__ import annotations

from collections.abc import Callable, Iterator, MutableMapping, Sequence
from dataclasses import dataclass
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats
from vaoi_station.mosaic.frames import TakenFrame
from vaoi_station.mosaic.grid import MosaicGrid
from vaoi_station.mosaic.projection import FrameProjector, between, shrunk
from vaoi_station.mosaic.reduction import Reduced, reduced
from vaoi_station.photometry import FlatFields
from vaoi_station.photometry.radiance import pixels_at_limit

Floats32 = NDArray[np.float32]
Copies = MutableMapping[tuple[int, int], Reduced]
"""Frames (camera, row), reduced by `COARSE_PX`."""
ReadFrame = Callable[[int, int], NDArray[Any] | None]
"""Returns the pixels of a frame (camera, row), (h, w) or (h, w, 3) of 8 or 16 bits; None if it is missing."""

COARSE_PX = 8
"""Side of a pixel of the survey, in pixels of the mosaic at the resolution of the cameras."""
BLOCK = 4
"""Side of the blocks whose means are compared, in pixels of the survey."""
_LEAST_COARSE = 2
"""Least width and height of the copy of a frame, in pixels of the survey."""


@dataclass(frozen=True, eq=False)
class SurveyedFrame:
    """The small copy of one frame, with its place on the survey's grid."""

    taken: TakenFrame
    x0: int
    """Column of the copy's first pixel on the survey's grid, a multiple of `BLOCK`."""
    y0: int
    values: Floats32
    """(h, w) radiance: grey levels (8 bit) per µs at gain 1; NaN beside the frame and where it is saturated."""
    raw_from_coarse: Floats
    """(3, 3) matrix from pixels of the survey's grid to raw pixels of the frame."""


class FieldCache:
    """Flat fields and dark levels of the cameras of a run, reduced to the resolution of the survey."""

    def __init__(self, fields: FlatFields) -> None:
        self._fields = fields
        self._reduced: dict[tuple[int, str | None, int], tuple[Floats32 | float, Floats32 | float]] = {}

    def reduced(self, camera: int, light: str | None, factor: int) -> tuple[Floats32 | float, Floats32 | float]:
        """Return flat field and dark level of a camera, as means over blocks of `factor` px, or as one value."""
        key = camera, light, factor
        if key not in self._reduced:
            maps = self._fields.maps(camera, light)
            flat = 1.0 if maps.flat is None else np.maximum(shrunk(maps.flat, factor), np.float32(0.02))
            dark = maps.dark if isinstance(maps.dark, float) else shrunk(maps.dark, factor)
            self._reduced[key] = flat, dark
        return self._reduced[key]


def survey(
    frames: Sequence[TakenFrame],
    read: ReadFrame,
    projector: FrameProjector,
    grid: MosaicGrid,
    fields: FieldCache,
    copies: Copies | None = None,
) -> Iterator[SurveyedFrame]:
    """Read every frame once, and yield the small copies of those that show the board.

    Args:
        frames: the frames.
        read: returns the pixels of a frame, or None.
        projector: projects the board into the frames.
        grid: the mosaic at the resolution of the cameras.
        fields: flat fields.
        copies: gets the reduced frames as they are, without correction and in colour; None if they are not needed.
    """
    for taken in frames:
        box = projector.seen_box(taken.camera, taken.row, grid)
        step = COARSE_PX * BLOCK
        x0, y0 = box[0] // step * BLOCK, box[1] // step * BLOCK
        w, h = -(-box[2] // COARSE_PX) - x0, -(-box[3] // COARSE_PX) - y0
        if min(w, h) < _LEAST_COARSE or min(box[2] - box[0], box[3] - box[1]) < COARSE_PX:
            continue
        pixels = read(taken.camera, taken.row)
        if pixels is None:
            continue
        matrix = projector.raw_from_mosaic(taken.camera, taken.row, grid, box)
        raw_from_coarse = between(matrix, 1, COARSE_PX)
        shift = np.array([[1, 0, x0], [0, 1, y0], [0, 0, 1]], dtype=np.float64)
        copy = reduced(Reduced(pixels, pixels), COARSE_PX)
        whole = pixels.shape[0] // COARSE_PX, pixels.shape[1] // COARSE_PX
        small = _radiance(copy, whole, taken, fields)
        values = cv2.warpPerspective(
            small,
            between(matrix, COARSE_PX, COARSE_PX) @ shift,
            (w, h),
            flags=cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP,
            borderMode=cv2.BORDER_CONSTANT,
            borderValue=float("nan"),
        )
        if copies is not None:
            copies[taken.camera, taken.row] = copy
        yield SurveyedFrame(taken, x0, y0, np.asarray(values, np.float32), raw_from_coarse)


def _radiance(copy: Reduced, size: tuple[int, int], taken: TakenFrame, fields: FieldCache) -> Floats32:
    """Return the radiance of a frame from its copy that is reduced by `COARSE_PX`; NaN where blocks are saturated.

    `size` is the number of rows and columns of whole blocks. What is left beside them is cut off.
    """
    h, w = size
    means, largest = (part[:h, :w] for part in copy)
    full = 255 if means.dtype == np.uint8 else 65535
    flat, dark = fields.reduced(taken.camera, taken.light, COARSE_PX)
    grey = means if means.ndim == 2 else np.asarray(cv2.cvtColor(means, cv2.COLOR_BGR2GRAY))
    value = (grey.astype(np.float32) * np.float32(255 / full) - dark) / flat
    value /= np.float32(taken.sensitivity)
    value[pixels_at_limit(largest)] = np.nan
    return np.asarray(value, np.float32)
