"""Measure the blur of a frame at the edges of marks, whose contrast is known."""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats

BLUR_LIMIT_PX = 2.0
"""Largest blur (standard deviation of an edge) of pictures in which marks and corners are measured, px."""
_STEEPEST = 200
"""Number of pixels on edges from which the blur is measured."""


def measure_blur_px(grey: NDArray[np.uint8], px: Floats, size_px: float) -> float:
    """Measure the median standard deviation of the blur at the edges of marks at px (k, 2).

    The largest slope of an edge of height C blurred by sigma is C / (sigma √(2π)). The result includes the width of a
    pixel.
    """
    half, found = int(np.ceil(0.6 * size_px)), []
    for x, y in np.round(px).astype(int):
        patch = grey[max(y - half, 0) : y + half + 1, max(x - half, 0) : x + half + 1]
        # Noise widens the range of grey levels, so that noisy marks would look blurred.
        low, high = (float(v) for v in np.percentile(cv2.medianBlur(np.ascontiguousarray(patch), 3), [5, 95]))
        found.append(steepest_edge_blur(patch, high - low))
    return float(np.median(found))


def steepest_edge_blur(patch: NDArray[np.uint8], contrast: float) -> float:
    """Measure the blur at the steepest edges of a patch, as a standard deviation in px."""
    # Smoothing suppresses noise in the slopes. The variance of the smoothing, 1 px², and that of a difference over two
    # pixels, 1/3 px², are subtracted.
    smooth = cv2.GaussianBlur(patch.astype(np.float32), (0, 0), 1.0)
    gx, gy = cv2.Sobel(smooth, cv2.CV_32F, 1, 0, scale=1 / 8), cv2.Sobel(smooth, cv2.CV_32F, 0, 1, scale=1 / 8)
    slopes = np.hypot(gx, gy).ravel()
    few = min(_STEEPEST, slopes.size // 20 + 1)
    steepest = max(float(np.median(np.partition(slopes, -few)[-few:])), 1e-6)
    return float(np.sqrt(max((contrast / (steepest * np.sqrt(2 * np.pi))) ** 2 - 1.3, 0.0)))
