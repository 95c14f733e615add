"""Temporary images (paper, section 3.4): one upright picture of a component, resampled from one frame (bilinear)."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.rendering.view import View

_FLAGS = cv2.INTER_LINEAR | cv2.WARP_INVERSE_MAP


def render(view: View, frame: NDArray[Any]) -> NDArray[Any]:
    """Resample a frame into one temporary image, (height, width) or (height, width, channels).

    The image has the pixel type of the frame: every pixel is the bilinear interpolation at the place that equation 22
    states, within one grey level. Places outside the frame are black; within one pixel of its border the image fades to
    black. If lens distortion matters in this view, the image is made in tiles, with an
    error of at most 0.005 px for the lenses of such an array.
    """
    # WARP_INVERSE_MAP: `matrix` maps the picture to the frame already, so OpenCV must not invert it.
    if not view.tiles:
        warped: NDArray[Any] = cv2.warpPerspective(frame, view.matrix, (view.width, view.height), flags=_FLAGS)
        return warped
    picture = np.empty((view.height, view.width, *frame.shape[2:]), dtype=frame.dtype)
    for t in view.tiles:
        # OpenCV writes into the picture itself: a copy of every tile would take a fifth of the time.
        part = picture[t.y0 : t.y1, t.x0 : t.x1]
        cv2.warpPerspective(frame, t.matrix, (t.x1 - t.x0, t.y1 - t.y0), dst=part, flags=_FLAGS)
    return picture
