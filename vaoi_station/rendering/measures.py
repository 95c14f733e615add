"""Figures of how well a frame shows a component: sharpness, and the share of saturated pixels.

They are measured on the pixels of the frame inside the component's footprint, and not on the temporary image: so they
do not depend on its resolution, margin or orientation.
"""

from __future__ import annotations

import math
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats
from vaoi_station.rendering.view import View

_LEAST_PIXELS = 9
"""Least number of pixels that are measured; fewer have no gradient worth a figure."""
_SOBEL = 8.0
"""Sum of the positive weights of the Sobel operator times the distance that they span: it gives grey levels per px."""
_SOBEL_NOISE = 2 * 12 / _SOBEL**2
"""Sum of the squared weights of both Sobel operators: share of the noise's variance in the squared gradient."""
_NOISE_MASK = np.array([[1, -2, 1], [-2, 4, -2], [1, -2, 1]], dtype=np.float32)
"""A mask that answers to noise, and hardly to edges (Immerkær 1996, Computer Vision and Image Understanding 64)."""
_MEDIAN = 0.6745
"""Median of the magnitude of a normal variable, in standard deviations."""


class Measures(NamedTuple):
    """How well a frame shows a component."""

    sharpness_per_mm: float | None
    """Root mean square of the gradient, divided by the standard deviation of the grey levels, 1/mm.

    This is the mean spatial frequency of what the frame shows. It falls with every blur, and does not depend on
    exposure and gain as long as nothing is saturated. It is None where the footprint has a single grey level.
    """
    saturated: float | None
    """Share of the footprint's pixels that have the largest value that the frame can have; None without a pixel."""


def measure(view: View, frame: NDArray[Any]) -> Measures:
    """Measure the frame inside the footprint of the view's component.

    Args:
        view: the view; its footprint in the frame is used.
        frame: (h, w) or (h, w, 3) pixels of the whole frame, 8 or 16 bit.
    """
    height, width = frame.shape[:2]
    # One pixel around the footprint, for the gradients at its edge.
    x0, y0 = (max(math.floor(v) - 1, 0) for v in view.outline_px.min(0).tolist())
    x1, y1 = (
        min(math.ceil(v) + 2, most) for v, most in zip(view.outline_px.max(0).tolist(), (width, height), strict=True)
    )
    if x1 - x0 < 3 or y1 - y0 < 3:
        return Measures(None, None)
    part = frame[y0:y1, x0:x1]
    return _measure(part, _inside(view.outline_px - (x0, y0), part.shape[:2]), view.frame_px_per_mm)


def _inside(outline_px: Floats, shape: tuple[int, ...]) -> NDArray[np.bool_]:
    """Return which pixels of a part of a frame (h, w) lie in a polygon."""
    mask = np.zeros(shape, np.uint8)
    cv2.fillConvexPoly(mask, np.round(outline_px * 16).astype(np.int32), 1, shift=4)
    return mask.astype(bool)


def _measure(part: NDArray[Any], inside: NDArray[np.bool_], px_per_mm: float) -> Measures:
    count = int(inside.sum())
    if count < _LEAST_PIXELS:
        return Measures(None, None)
    at_limit = part == np.iinfo(part.dtype).max
    saturated = float((at_limit if part.ndim == 2 else at_limit.any(2))[inside].mean())
    grey = np.asarray(part if part.ndim == 2 else cv2.cvtColor(part, cv2.COLOR_BGR2GRAY), dtype=np.float32)
    x = cv2.Sobel(grey, cv2.CV_32F, 1, 0, scale=1 / _SOBEL)[inside]
    y = cv2.Sobel(grey, cv2.CV_32F, 0, 1, scale=1 / _SOBEL)[inside]
    # Noise has a gradient as well: without this, a darker frame would be the sharper one.
    answer = np.abs(cv2.filter2D(grey, cv2.CV_32F, _NOISE_MASK)[inside])
    noise = (float(np.median(answer)) / _MEDIAN) ** 2 / float((_NOISE_MASK**2).sum())
    gradient = float((x * x + y * y).mean()) - _SOBEL_NOISE * noise
    variance = float(grey[inside].var(dtype=np.float64)) - noise
    if variance <= max(noise / math.sqrt(count), 1e-9):
        return Measures(None, saturated)
    return Measures(math.sqrt(max(gradient, 0.0) / variance) * px_per_mm, saturated)
