"""Temporary images (paper, section 3.4): one upright picture of a component, resampled from one frame (bilinear)."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.rendering.views import View

_FLAGS = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP


def render(view: View, frame: NDArray[Any]) -> NDArray[Any]:
    """Resample a frame into one temporary image, (height, width) or (height, width, channels).

    The image has the pixel type of the frame. Places outside the frame are black. If lens distortion matters in this
    view, the image is made in tiles, with an error of at most 0.03 px for the lenses of such an array.
    """
    # WARP_INVERSE_MAP: `matrix` maps the picture to the frame already, so OpenCV must not invert it.
    if not view.tiles:
        return np.asarray(cv2.warpPerspective(frame, view.matrix, (view.width, view.height), flags=_FLAGS))
    picture = np.empty((view.height, view.width, *frame.shape[2:]), dtype=frame.dtype)
    for t in view.tiles:
        size = (t.x1 - t.x0, t.y1 - t.y0)
        picture[t.y0 : t.y1, t.x0 : t.x1] = cv2.warpPerspective(frame, t.matrix, size, flags=_FLAGS)
    return picture
