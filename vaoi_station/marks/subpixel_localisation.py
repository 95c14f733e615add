"""The place of a mark to a few hundredths of a pixel.

Discs by a fit of their picture (`disc`), every other mark by its point symmetry (`symmetry`). Neither depends on
brightness or gain, on its slope across the mark, or on how much of the rim is bare. Marks that are partly covered or
lie in a glare say so by their standard deviation (`evenness`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.marks import disc_fit, symmetry_fit
from vaoi_station.marks.asymmetry import asymmetry_sigma_px
from vaoi_station.marks.candidate_search import SURROUND
from vaoi_station.marks.mark_shape import CROSS_ARM, Shape
from vaoi_station.marks.template_correlation import SHAPE_CODE, correlate_with_shape

_COARSE_SIDE = 24
"""Larger marks are first looked at through about so many samples per side."""
_QUICK_SIDE = 12
"""The same for places that need not be precise."""
_STEPS, _QUICK_STEPS = 12, 5
"""Of the fit of a disc, at the most: bare discs take three, what is none seldom comes to rest."""
_SMOOTH, _LEAST_SMOOTH_PX, _MOST_SMOOTH_PX = 1 / 16, 0.8, 1.5
"""Blur before symmetry is judged, in sizes and px: what aliasing the sensor left is out of it then."""
_EDGE_PX = 2.0
"""So far from a mark its edge is felt."""
_SHARP_PX = 0.67
"""Blur of a sharp camera's edge, the pixel's own width included."""
_LEAST_SCORE = 0.75
_LEAST_CONTRAST = 8.0
_LEAST_SIGMA_PX = 0.005
_MOST_OFF_SIZE = 0.15
"""Discs that are larger or smaller than the artwork by a greater share are others, or partly covered."""


@dataclass(frozen=True)
class Mark:
    """A mark found: where, how surely, how alike the artwork, and whether it is light on dark."""

    px: Floats
    sigma_px: float
    score: float
    light: bool


def locate_mark(
    image: NDArray[np.uint8],
    near_px: Floats,
    shape: Shape,
    size_px: float,
    *,
    arm: float = CROSS_ARM,
    surround: float = SURROUND,
    precise: bool = True,
) -> Mark | Failure:
    """Refine a mark near a place that is right to a third of its size.

    Args:
        image: (h, w) full frame.
        near_px: (2,) raw pixels.
        shape: of the mark.
        size_px: its size in this image.
        arm: width of a cross' arm as a share of its size.
        surround: diameter of what is compared with the artwork, in sizes: the mark and the bare rim around it.
        precise: discs can be had in a third of the time, to a few hundredths of a pixel, without it.
    """
    half = int(np.ceil(surround * size_px / 2)) + 4
    x, y = (round(float(v)) for v in near_px)
    if not (half <= x < image.shape[1] - half and half <= y < image.shape[0] - half):
        return Failure(f"the mark at ({x}, {y}) px is cut off by the frame's border")
    image = image.view()
    image.flags.writeable = False  # a function is compiled anew for arrays that may be written
    start = float(near_px[0]), float(near_px[1])
    found = _disc(image, start, size_px, precise) if shape == "circle" else _symmetric(image, start, size_px, half)
    if isinstance(found, Failure):
        return found
    px, sigma = found
    score, contrast = correlate_with_shape(image, px[0], px[1], SHAPE_CODE[shape], size_px, arm, surround * size_px)
    if abs(contrast) < _LEAST_CONTRAST:
        return Failure(f"contrast {abs(contrast):.0f} of the mark at ({x}, {y}) px is below {_LEAST_CONTRAST:.0f}")
    if score < _LEAST_SCORE:
        return Failure(f"correlation {score:.2f} of the mark at ({x}, {y}) px is below {_LEAST_SCORE}")
    if precise:
        sigma = math.hypot(sigma, asymmetry_sigma_px(image, px, size_px, contrast, sigma))
    return Mark(np.array(px), max(sigma, _LEAST_SIGMA_PX), score, contrast > 0)


Place = tuple[tuple[float, float], float]
"""Where, and its standard deviation per axis."""


def _disc(image: NDArray[np.uint8], start: tuple[float, float], size_px: float, precise: bool) -> Place | Failure:
    quick = max(round(size_px / _QUICK_SIDE), 1), 0.02, _QUICK_STEPS
    stride, enough_px, steps = (1, 1e-3, _STEPS) if precise else quick
    fitted = disc_fit.fit_disc(image, *start, size_px / 2, size_px / 3 + 2, stride, enough_px, steps)
    code, x, y, sigma, radius, *_ = fitted
    if code == disc_fit.NO_EDGE:
        return Failure("no round edge: nothing fixes a centre")
    if code == disc_fit.TOO_FAR:
        return Failure("no round edge near the predicted place")
    if abs(2 * radius / size_px - 1) > _MOST_OFF_SIZE:
        return Failure(
            f"the disc at ({x:.0f}, {y:.0f}) px has a diameter of {2 * radius:.1f} px, more than {_MOST_OFF_SIZE:.0%} "
            f"off the artwork's {size_px:.1f} px: another one, or partly covered"
        )
    return (x, y), sigma


def _symmetric(image: NDArray[np.uint8], start: tuple[float, float], size_px: float, half: int) -> Place | Failure:
    reach, coarse = math.ceil(0.5 * size_px + _EDGE_PX), max(round(size_px / _COARSE_SIDE), 1)
    furthest = size_px / 3 + 2
    left, top = round(start[0]) - half, round(start[1]) - half
    patch = image[top : top + 2 * half + 1, left : left + 2 * half + 1]
    pad = int(furthest) + symmetry_fit.BEFORE + symmetry_fit.AFTER + 1
    blur = min(max(_SMOOTH * size_px, _LEAST_SMOOTH_PX), _MOST_SMOOTH_PX)
    smooth = cv2.GaussianBlur(patch.astype(np.float32), (0, 0), blur)
    smooth = cv2.copyMakeBorder(smooth, pad, pad, pad, pad, cv2.BORDER_REPLICATE)
    at = start[0] - left + pad, start[1] - top + pad
    code, x, y, sigma = symmetry_fit.fit_symmetry(np.asarray(smooth), *at, reach, furthest, coarse)
    if code == symmetry_fit.NOTHING_FIXES:
        return Failure("no point symmetry: the picture changes in one direction only")
    if code == symmetry_fit.TOO_FAR:
        return Failure("no centre of symmetry near the predicted place")
    return (x + left - pad, y + top - pad), sigma * _correlated(blur)


def _correlated(blur_px: float) -> float:
    """By how much the noise of a smoothed picture, alike in neighbours, moves an edge more than white noise."""
    s2, edge2 = blur_px**2, _SHARP_PX**2
    return math.sqrt(4 * math.pi * s2 * math.sqrt((edge2 + s2) / (edge2 + 2 * s2)))
