"""Focus and exposure of one frame, as numbers.

Two numbers tell the focus. `focus`, the variance of the Laplacian over the squared mean, rises while one turns
towards the best focus, on any scene, but says nothing by itself. `blur_px` does, where the scene has edges:
an edge of height C blurred by σ is steepest by C / (σ √(2π)); the modulation falls to one half at 0.187 / σ.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.calibration.mark_detection import to_grey
from vaoi_station.files.images import Image

TILES = 3
"""The frame's parts whose blur is told by itself: a camera that is tilted is sharp on one side only."""
_MTF50 = 0.1874
"""Cycles per pixel at which a blur of σ = 1 px has half the modulation: √(2 ln 2) / (2π)."""
_SMOOTH_PX = 1.0
_OWN_VARIANCE = _SMOOTH_PX**2 + 1 / 3
"""Of the smoothing, and of the difference of neighbours that stands for the slope."""
_PIXEL_VARIANCE = 1 / 12
_REACH_PX = 7
"""Within this distance of an edge both its sides are found."""
_THIN_PX, _BROAD = 2, 0.85
"""Lines thinner than so much to both sides are no edges: without them the contrast must remain, to such a share."""
_LEAST_CONTRAST = 24.0
"""Grey levels of 255; weaker edges are noise."""
_BLOCK_PX = 24
"""One edge is taken of every block of the frame."""
_LEAST_EDGES = 6
_DIFFERENCE = np.array([[-0.5, 0.0, 0.5]], dtype=np.float32)
_SHARPER = 0.5
"""Of the edges, the sharper half is the lens; the others are shadows and slopes of parts."""


@dataclass(frozen=True)
class ImageQuality:
    """What one frame says of focus and exposure; levels are shares of the full scale."""

    focus: float
    """Higher is sharper; comparable only for the same scene."""
    blur_px: float | None
    """Standard deviation of the blur across edges, the pixel's own width included; None without edges."""
    mtf50: float | None
    """Spatial frequency of half the modulation, cycles per pixel."""
    blur_tiles_px: tuple[tuple[float | None, ...], ...]
    """3 × 3 parts of the frame, from the top left."""
    mean: float
    low: float
    """1st percentile."""
    high: float
    """99th percentile."""
    saturated: float
    """Share of the pixels that are as bright as pixels can be."""


def measure(pixels: Image) -> ImageQuality:
    """The figures of a frame (h, w) or (h, w, 3), 8 or 16 bit."""
    channels = pixels if pixels.ndim == 2 else pixels.max(axis=2)
    full = full_scale(channels)
    low, high = (float(v) / full for v in np.percentile(channels[::2, ::2], [1, 99]))
    grey = to_grey(pixels)
    blurs = _blur_of_blocks(grey)
    rows = [np.array_split(part, TILES, axis=1) for part in np.array_split(blurs, TILES, axis=0)]
    blur = _sharpest(blurs)
    return ImageQuality(
        focus=_focus(grey),
        blur_px=blur,
        mtf50=None if blur is None else min(_MTF50 / max(blur, 1e-6), 0.5),
        blur_tiles_px=tuple(tuple(_sharpest(tile) for tile in row) for row in rows),
        mean=float(channels.mean()) / full,
        low=low,
        high=high,
        saturated=float((channels >= full).mean()),
    )


def full_scale(pixels: Image) -> int:
    """The largest value a pixel can have; of 16-bit frames by the bits that are in use (8, 10, 12, 14 or 16)."""
    if pixels.dtype == np.uint8:
        return 255
    used = int(pixels.max(initial=0)).bit_length()
    return int((1 << next(bits for bits in (8, 10, 12, 14, 16) if bits >= used)) - 1)


def _focus(grey: NDArray[np.uint8]) -> float:
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (3, 3), 0)
    mean = max(float(smooth.mean()), 1.0)
    return float(cv2.Laplacian(smooth, cv2.CV_32F).var()) / mean**2


def _blur_of_blocks(grey: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Blur in px of the sharpest edge of every block of the frame; NaN where there is none."""
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _SMOOTH_PX)
    slope = cv2.magnitude(*(cv2.filter2D(smooth, -1, k) for k in (_DIFFERENCE, _DIFFERENCE.T)))
    contrast, broad = _contrasts(cv2.convertScaleAbs(smooth))
    ridge = slope >= cv2.dilate(slope, _square(_REACH_PX))
    edge = ridge & (contrast >= _LEAST_CONTRAST) & (broad >= _BROAD * contrast)
    steep = np.where(edge, slope / np.maximum(contrast, 1.0), 0.0)
    h, w = (max(side // _BLOCK_PX, 1) for side in grey.shape)
    cut = steep[: h * _BLOCK_PX, : w * _BLOCK_PX]
    size = (cut.shape[0] // h, cut.shape[1] // w)
    best = cut[: h * size[0], : w * size[1]].reshape(h, size[0], w, size[1]).max(axis=(1, 3)).astype(np.float64)
    with np.errstate(divide="ignore"):
        total = 1 / (best * np.sqrt(2 * np.pi))
    return np.where(best > 0, np.sqrt(np.maximum(total**2 - _OWN_VARIANCE, _PIXEL_VARIANCE)), np.nan)


def _contrasts(smooth: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Lightest less darkest value around every pixel; the same without what is thin."""
    around, thin = _square(_REACH_PX), _square(_THIN_PX)
    contrast = cv2.subtract(cv2.dilate(smooth, around), cv2.erode(smooth, around), dtype=cv2.CV_32F)
    light = cv2.dilate(cv2.morphologyEx(smooth, cv2.MORPH_OPEN, thin), around)
    dark = cv2.erode(cv2.morphologyEx(smooth, cv2.MORPH_CLOSE, thin), around)
    return np.asarray(contrast), np.asarray(cv2.subtract(light, dark, dtype=cv2.CV_32F))


def _square(reach: int) -> NDArray[np.uint8]:
    return np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)


def _sharpest(blurs: NDArray[np.float64]) -> float | None:
    """The median of the sharper half; None if there are too few edges."""
    found = np.sort(blurs[np.isfinite(blurs)])
    if len(found) < _LEAST_EDGES:
        return None
    return float(np.median(found[: max(int(len(found) * _SHARPER), _LEAST_EDGES)]))
