"""Temporary images (section 3.4): one upright picture of a component from one frame, by bilinear interpolation."""

from __future__ import annotations

from functools import lru_cache
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.rendering.views import GRID, View

_FLAGS = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP


def render(view: View, frame: NDArray[Any]) -> NDArray[Any]:
    """Resample one temporary image, (height, width) or (height, width, channels), in the frame's own pixel type.

    Places outside the frame are black. Where the lens bends, raw pixels are interpolated between the
    view's nodes: exact to a few thousandths of a pixel for the lenses of such an array.
    """
    if view.raw_nodes is None:
        return np.asarray(cv2.warpPerspective(frame, view.matrix, (view.width, view.height), flags=_FLAGS))
    down, across = _between(view.height), _between(view.width)
    x, y = (down @ nodes @ across.T for nodes in view.raw_nodes.astype(np.float32).transpose(2, 0, 1))
    return np.asarray(cv2.remap(frame, x, y, cv2.INTER_LINEAR))


@lru_cache(maxsize=256)
def _between(size: int) -> NDArray[np.float32]:
    """Weights (size, nodes) of linear interpolation between nodes spread from the first pixel to the last."""
    at = np.linspace(0, GRID - 1, size) if size > 1 else np.zeros(1)
    left = np.minimum(at.astype(int), GRID - 2)
    weights = np.zeros((size, GRID), dtype=np.float32)
    n = np.arange(size)
    weights[n, left], weights[n, left + 1] = 1 - (at - left), at - left
    return weights
