"""Temporary images (section 3.4): one upright picture of a component from one frame, by bilinear interpolation."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.rendering.views import View

_FLAGS = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP


def render(view: View, frame: NDArray[Any]) -> NDArray[Any]:
    """Resample one temporary image, (height, width) or (height, width, channels), in the frame's own pixel type.

    Places outside the frame are black. Where the lens bends, the picture is made in tiles, exact to 0.03 px for
    the lenses of such an array.
    """
    # WARP_INVERSE_MAP: `matrix` leads from the picture to the frame, and OpenCV must not invert it.
    if not view.tiles:
        return np.asarray(cv2.warpPerspective(frame, view.matrix, (view.width, view.height), flags=_FLAGS))
    picture = np.empty((view.height, view.width, *frame.shape[2:]), dtype=frame.dtype)
    for t in view.tiles:
        size = (t.x1 - t.x0, t.y1 - t.y0)
        picture[t.y0 : t.y1, t.x0 : t.x1] = cv2.warpPerspective(frame, t.matrix, size, flags=_FLAGS)
    return picture
