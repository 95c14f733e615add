"""The order of pixels under a Bayer filter in which neighbours have filters of the same colour."""

from __future__ import annotations

import numpy as np
from numpy.typing import NDArray

from vaoi_station.files.images import Image


def sorted_by_colour(plane: Image) -> Image:
    """Return a plane with its even rows above its odd ones, and its even columns left of its odd ones."""
    return plane[_order(plane.shape[0])[:, None], _order(plane.shape[1])]


def in_order(plane: NDArray[np.uint16]) -> NDArray[np.uint16]:
    """Undo `sorted_by_colour`."""
    out = np.empty_like(plane)
    out[_order(plane.shape[0])[:, None], _order(plane.shape[1])] = plane
    return out


def _order(size: int) -> NDArray[np.intp]:
    return np.concatenate((np.arange(0, size, 2), np.arange(1, size, 2)))
