"""Frames divided by the flat fields of their cameras, so that lamps and vignetting leave no slope in the pictures."""

from __future__ import annotations

from collections.abc import Callable, Sequence
from typing import Any

import numpy as np
from numpy.typing import NDArray

from vaoi_station.photometry import FlatFields
from vaoi_station.pixel_formats import eight_bit_grey

_FULL = 255.0


def equalised_frames(
    frame: Callable[[int, int], NDArray[Any] | None], fields: FlatFields, lights: Sequence[str] = ()
) -> Callable[[int, int], NDArray[Any] | None]:
    """Return a function of camera and row that gives (grey − dark) / flat as 32-bit floats; None for a missing frame.

    Saturated pixels stay saturated.

    Args:
        frame: function that returns the pixels of a camera and row.
        fields: flat fields of the array.
        lights: name of the light of every row; empty if all rows have one.
    """

    def equalised(camera: int, row: int) -> NDArray[Any] | None:
        pixels = frame(camera, row)
        if pixels is None:
            return None
        grey = eight_bit_grey(pixels)
        maps = fields.maps(camera, lights[row] if lights else None)
        flat = np.float32(1) if maps.flat is None else np.maximum(maps.flat, np.float32(0.02))
        # In place, because a worker does this between the urgent tasks of a board that passes.
        value = np.subtract(grey, np.asarray(maps.dark, np.float32), dtype=np.float32)
        np.divide(value, flat, out=value)
        full = grey >= _FULL
        value[full] = np.maximum(value[full], np.float32(_FULL))
        return value

    return equalised
