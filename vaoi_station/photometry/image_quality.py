"""Focus and exposure figures of one frame.

Two figures describe the focus. `focus` is the variance of the Laplacian divided by the squared mean. It rises towards
the best focus in any scene, but only values of the same scene can be compared. `blur_px` is an absolute figure, but
needs edges in the scene: an edge of contrast C that is blurred by a Gaussian of standard deviation σ has the maximum
slope C / (σ √(2π)), and the modulation falls to one half at 0.187 / σ cycles per pixel.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.files.images import Image
from vaoi_station.pixel_formats import eight_bit_grey

BINS = 64
"""Number of steps of grey of a histogram."""
TILES = 3
"""Parts per side of the frame whose blur is measured separately: a tilted camera is sharp on one side only."""
_MTF50 = 0.1874
"""Spatial frequency, cycles per pixel, at which a blur of σ = 1 px halves the modulation: √(2 ln 2) / (2π)."""
_SMOOTH_PX = 1.0
_OWN_VARIANCE = _SMOOTH_PX**2 + 1 / 3
"""Variance in px² that the measurement adds to the blur, by smoothing and by the finite difference for the slope."""
_PIXEL_VARIANCE = 1 / 12
"""Variance in px² of a box of one pixel's width, the lower limit for the variance of a measured blur."""
_REACH_PX = 7
"""Distance from an edge, in px, within which the grey levels of both sides are measured."""
_THIN_PX, _BROAD = 2, 0.85
"""Half width (px) of lines that are removed, and share of contrast that an edge must keep.

So a thin line does not count as an edge."""
_LEAST_CONTRAST = 24.0
"""Least contrast of an edge in grey levels, 0 … 255. Weaker edges are noise."""
_BLOCK_PX = 24
"""Side in px of the blocks into which a frame is divided. The sharpest edge of each block is used."""
_LEAST_EDGES = 6
"""Least number of edges from which a blur is computed."""
_DIFFERENCE = np.array([[-0.5, 0.0, 0.5]], dtype=np.float32)
_SHARPER = 0.5
"""Share of the edges that is used. The sharper half shows the lens blur; the others are shadows and sloping parts."""


@dataclass(frozen=True)
class ImageQuality:
    """Focus and exposure of one frame. Grey levels are shares of the full scale, 0 … 1."""

    focus: float
    """Figure of focus: a higher value is sharper. Comparable only between frames of the same scene."""
    blur_px: float | None
    """Standard deviation in px of the blur across edges, pixel width included; None if there are too few edges."""
    mtf50: float | None
    """Spatial frequency in cycles per pixel at which the modulation falls to one half."""
    blur_tiles_px: tuple[tuple[float | None, ...], ...]
    """`blur_px` of each of the 3 × 3 parts of the frame, in rows from the top left."""
    mean: float
    low: float
    """Grey level below which 1 % of the pixels lie."""
    high: float
    """Grey level below which 99 % of the pixels lie."""
    saturated: float
    """Share of the pixels at full scale."""


def measure_quality(pixels: Image) -> ImageQuality:
    """Measure focus and exposure of a frame (height, width) or (height, width, 3), 8 or 16 bit."""
    # The brightest channel is used, because one saturated colour already spoils the frame.
    channels = pixels if pixels.ndim == 2 else pixels.max(axis=2)
    full = full_scale(channels)
    # Every second pixel in each direction suffices for percentiles, at a quarter of the cost.
    low, high = (float(v) / full for v in np.percentile(channels[::2, ::2], [1, 99]))
    grey = eight_bit_grey(pixels)
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


def histogram(pixels: Image) -> tuple[float, ...]:
    """Return the share of the pixels in each of `BINS` equal steps of grey; of colours, their brightest channel."""
    channels = pixels if pixels.ndim == 2 else pixels.max(axis=2)
    counts = cv2.calcHist([np.ascontiguousarray(channels)], [0], None, [BINS], [0, full_scale(channels) + 1])
    return tuple(round(float(n) / channels.size, 5) for n in counts.ravel())


def full_scale(pixels: Image) -> int:
    """Return the largest possible pixel value. Frames of more than 8 bits arrive at full scale (`pixel_formats`)."""
    return 255 if pixels.dtype == np.uint8 else 65535


def _focus(grey: NDArray[np.uint8]) -> float:
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (3, 3), 0)
    mean = max(float(smooth.mean()), 1.0)
    return float(cv2.Laplacian(smooth, cv2.CV_32F).var()) / mean**2


def _blur_of_blocks(grey: NDArray[np.uint8]) -> NDArray[np.float64]:
    """Return an array with the blur (px) of the sharpest edge of each block; NaN for blocks without edges."""
    smooth = cv2.GaussianBlur(grey.astype(np.float32), (0, 0), _SMOOTH_PX)
    slope = cv2.magnitude(*(cv2.filter2D(smooth, -1, k) for k in (_DIFFERENCE, _DIFFERENCE.T)))
    contrast, broad = _contrasts(cv2.convertScaleAbs(smooth))
    # The maximum of the slope within reach marks the edge itself, not its flanks.
    ridge = slope >= cv2.dilate(slope, _square(_REACH_PX))
    edge = ridge & (contrast >= _LEAST_CONTRAST) & (broad >= _BROAD * contrast)
    steep = np.where(edge, slope / np.maximum(contrast, 1.0), 0.0)
    h, w = (max(side // _BLOCK_PX, 1) for side in grey.shape)
    cut = steep[: h * _BLOCK_PX, : w * _BLOCK_PX]
    size = (cut.shape[0] // h, cut.shape[1] // w)
    best = cut[: h * size[0], : w * size[1]].reshape(h, size[0], w, size[1]).max(axis=(1, 3)).astype(np.float64)
    # Blocks without an edge divide by zero here and become NaN below.
    with np.errstate(divide="ignore"):
        total = 1 / (best * np.sqrt(2 * np.pi))
    return np.where(best > 0, np.sqrt(np.maximum(total**2 - _OWN_VARIANCE, _PIXEL_VARIANCE)), np.nan)


def _contrasts(smooth: NDArray[np.uint8]) -> tuple[NDArray[np.float32], NDArray[np.float32]]:
    """Return two maps of the local contrast around each pixel: with all structures, and with thin lines removed."""
    around, thin = _square(_REACH_PX), _square(_THIN_PX)
    contrast = cv2.subtract(cv2.dilate(smooth, around), cv2.erode(smooth, around), dtype=cv2.CV_32F)
    light = cv2.dilate(cv2.morphologyEx(smooth, cv2.MORPH_OPEN, thin), around)
    dark = cv2.erode(cv2.morphologyEx(smooth, cv2.MORPH_CLOSE, thin), around)
    return np.asarray(contrast), np.asarray(cv2.subtract(light, dark, dtype=cv2.CV_32F))


def _square(reach: int) -> NDArray[np.uint8]:
    return np.ones((2 * reach + 1, 2 * reach + 1), np.uint8)


def _sharpest(blurs: NDArray[np.float64]) -> float | None:
    """Return the median blur of the sharper half of the edges; None if there are too few edges."""
    found = np.sort(blurs[np.isfinite(blurs)])
    if len(found) < _LEAST_EDGES:
        return None
    return float(np.median(found[: max(int(len(found) * _SHARPER), _LEAST_EDGES)]))
