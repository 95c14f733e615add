"""Sub-pixel localisation of a mark, with errors of a few hundredths of a pixel.

Discs are located by a fit of their image (`disc_fit`), all other marks by their point symmetry (`symmetry_fit`). The
positions of both methods do not depend on brightness, gain, a gradient of the gain, or the width of the bare rim. A
mark that is partly covered or lies in glare gets a large standard deviation (`asymmetry`).
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
"""Number of samples across a mark in the coarse stage. Smaller marks are sampled at every pixel."""
_QUICK_SIDE = 12
"""Number of samples across a disc if `precise` is false."""
_MAX_STEPS, _MAX_QUICK_STEPS = 12, 5
"""Largest number of iterations of the disc fit, if `precise` is true or false. Undisturbed discs take three."""
_SMOOTH, _MIN_SMOOTH_PX, _MAX_SMOOTH_PX = 1 / 16, 0.8, 1.5
"""Blur before the symmetry fit, as a share of the mark's size, and its limits in px.

The blur removes the aliasing of the sensor."""
_EDGE_PX = 2.0
"""Width of the strip around a mark that its blurred edge affects."""
_SHARP_PX = 0.67
"""Blur (standard deviation) of an edge in a sharp frame, including the effect of the pixel area."""
_MIN_CORRELATION = 0.75
_MIN_CONTRAST = 8.0
_MIN_SIGMA_PX = 0.005
"""Lower limit of the standard deviation, because systematic errors of lens and sensor remain even without noise."""
_MAX_SIZE_ERROR = 0.15
"""Accepted relative difference between the fitted and the nominal diameter of a disc."""


@dataclass(frozen=True)
class Mark:
    """A located mark: centre (2,) in raw px, standard deviation per axis, correlation, whether light on dark."""

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
    """Locate a mark near a predicted position, whose error is at most a third of the mark's size.

    Args:
        image: (h, w) full frame.
        near_px: (2,) predicted centre, raw pixels.
        shape: shape of the mark.
        size_px: size of the mark in this image.
        arm: width of a cross' arm as a share of its size.
        surround: diameter of the disc compared with the shape (mark and bare rim), divided by the size of the mark.
        precise: if false, the fit of discs takes a third of the time, with errors of a few hundredths of a pixel.
    """
    half = int(np.ceil(surround * size_px / 2)) + 4
    x, y = (round(float(v)) for v in near_px)
    if not (half <= x < image.shape[1] - half and half <= y < image.shape[0] - half):
        return Failure(f"the mark at ({x}, {y}) px is cut off by the frame's border")
    image = image.view()
    # Numba compiles separate versions for writeable and read-only arrays, so all images are passed as read-only.
    image.flags.writeable = False
    start = float(near_px[0]), float(near_px[1])
    found = (
        _locate_disc(image, start, size_px, precise)
        if shape == "circle"
        else _locate_symmetric(image, start, size_px, half)
    )
    if isinstance(found, Failure):
        return found
    px, sigma = found
    # A fit converges on many objects. The correlation with the shape decides whether this object is the mark.
    score, contrast = correlate_with_shape(image, px[0], px[1], SHAPE_CODE[shape], size_px, arm, surround * size_px)
    if abs(contrast) < _MIN_CONTRAST:
        return Failure(f"contrast {abs(contrast):.0f} of the mark at ({x}, {y}) px is below {_MIN_CONTRAST:.0f}")
    if score < _MIN_CORRELATION:
        return Failure(f"correlation {score:.2f} of the mark at ({x}, {y}) px is below {_MIN_CORRELATION}")
    if precise:
        sigma = math.hypot(sigma, asymmetry_sigma_px(image, px, size_px, contrast, sigma))
    return Mark(np.array(px), max(sigma, _MIN_SIGMA_PX), score, contrast > 0)


Position = tuple[tuple[float, float], float]
"""A centre (x, y) in px, and its standard deviation per axis in px."""


def _locate_disc(
    image: NDArray[np.uint8], start: tuple[float, float], size_px: float, precise: bool
) -> Position | Failure:
    """Locate a disc by a fit of its image."""
    # If not `precise`, the fit uses fewer pixels and ends at larger steps.
    quick = max(round(size_px / _QUICK_SIDE), 1), 0.02, _MAX_QUICK_STEPS
    stride, enough_px, steps = (1, 1e-3, _MAX_STEPS) if precise else quick
    fitted = disc_fit.fit_disc(image, *start, size_px / 2, size_px / 3 + 2, stride, enough_px, steps)
    code, x, y, sigma, radius, *_ = fitted
    if code == disc_fit.NO_EDGE:
        return Failure("no round edge: the centre is undetermined")
    if code == disc_fit.TOO_FAR:
        return Failure("no round edge near the predicted position")
    if abs(2 * radius / size_px - 1) > _MAX_SIZE_ERROR:
        return Failure(
            f"the disc at ({x:.0f}, {y:.0f}) px has a diameter of {2 * radius:.1f} px, more than {_MAX_SIZE_ERROR:.0%} "
            f"off the nominal {size_px:.1f} px: another object, or partly covered"
        )
    return (x, y), sigma


def _locate_symmetric(
    image: NDArray[np.uint8], start: tuple[float, float], size_px: float, half: int
) -> Position | Failure:
    """Locate a mark of any shape by its point symmetry."""
    reach, coarse = math.ceil(0.5 * size_px + _EDGE_PX), max(round(size_px / _COARSE_SIDE), 1)
    furthest = size_px / 3 + 2
    left, top = round(start[0]) - half, round(start[1]) - half
    patch = image[top : top + 2 * half + 1, left : left + 2 * half + 1]
    pad = int(furthest) + symmetry_fit.BEFORE + symmetry_fit.AFTER + 1
    blur = min(max(_SMOOTH * size_px, _MIN_SMOOTH_PX), _MAX_SMOOTH_PX)
    smooth = cv2.GaussianBlur(patch.astype(np.float32), (0, 0), blur)
    # The window moves with the centre during the fit: replicated borders keep it inside near the patch's edge.
    smooth = cv2.copyMakeBorder(smooth, pad, pad, pad, pad, cv2.BORDER_REPLICATE)
    at = start[0] - left + pad, start[1] - top + pad
    code, x, y, sigma = symmetry_fit.fit_symmetry(np.asarray(smooth), *at, reach, furthest, coarse)
    if code == symmetry_fit.UNDETERMINED:
        return Failure("no point symmetry: the picture changes in one direction only")
    if code == symmetry_fit.TOO_FAR:
        return Failure("no centre of symmetry near the predicted position")
    return (x + left - pad, y + top - pad), sigma * _noise_factor(blur)


def _noise_factor(blur_px: float) -> float:
    """Return the factor for the standard deviation of a position measured in a smoothed image.

    Smoothing correlates the noise of neighbouring pixels. Such noise displaces an edge more than white noise does.
    """
    s2, edge2 = blur_px**2, _SHARP_PX**2
    return math.sqrt(4 * math.pi * s2 * math.sqrt((edge2 + s2) / (edge2 + 2 * s2)))
