"""Sub-pixel localisation of a mark, with errors of a few hundredths of a pixel.

Discs are located by a fit of their image (`disc_fit`), all other marks by their point symmetry (`symmetry_fit`). The
positions of both methods do not depend on brightness, gain, a gradient of the gain, or the width of the bare rim. A
mark that is partly covered or lies in glare gets a large standard deviation (`asymmetry`). If the edge of a shadow
crosses a mark, the light is made even first (`shadow_edge`).
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.marks import disc_fit, symmetry_fit
from vaoi_station.marks.asymmetry import asymmetry_sigma_px
from vaoi_station.marks.blur import measure_blur_px
from vaoi_station.marks.candidate_search import SURROUND
from vaoi_station.marks.clean_edges import centre_by_clean_edges
from vaoi_station.marks.mark_shape import CROSS_ARM, Shape
from vaoi_station.marks.shadow_edge import compared_reach_px, even_light, find_shadow_edge, light_unevenness
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
_UNEVEN_CHI2 = 15.0
"""χ² of the light's unevenness above which a shadow's edge is searched. Undisturbed marks exceed it rarely."""
_SHADOW_SIGMA = 0.2
"""Standard deviation of a correction for a shadow's edge or a smudge, as a share of its length."""
_BEYOND_PX = 6
"""Width of what is cut out around a mark beyond its bare rim, px: the fit itself needs 4 px around its start."""


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

    `image` (h, w) is the full frame, `near_px` (2,) the prediction in raw pixels, `arm` the width of a cross' arm as a
    share of its size, and `surround` the diameter of the mark with its bare rim, divided by the size of the mark. If
    not `precise`, the fit of discs takes a third of the time, with errors of a few hundredths of a pixel.
    """
    image = image.view()
    # Numba compiles separate versions for writeable and read-only arrays, so all images are passed as read-only.
    image.flags.writeable = False
    sought = _Sought(shape, size_px, arm, surround)
    found = _locate(image, (float(near_px[0]), float(near_px[1])), sought, precise)
    if isinstance(found, Failure):
        return found
    if not precise:
        return found[0]
    mark, asymmetric = _without_shadow(image, *found, sought)
    return _by_clean_edges(image, mark, sought) if asymmetric and shape == "circle" else mark


class _Sought(NamedTuple):
    shape: Shape
    size_px: float
    arm: float
    surround: float


def _locate(
    image: NDArray[np.uint8], start: tuple[float, float], sought: _Sought, precise: bool
) -> tuple[Mark, bool] | Failure:
    """Locate a mark near a predicted position. The second value is whether it is less symmetric than usual."""
    shape, size_px, arm, surround = sought
    half = math.ceil(surround * size_px / 2) + 4
    x, y = round(start[0]), round(start[1])
    if not (half <= x < image.shape[1] - half and half <= y < image.shape[0] - half):
        return Failure(f"the mark at ({x}, {y}) px is cut off by the frame's border")
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
    asymmetric = asymmetry_sigma_px(image, px, size_px, contrast, sigma) if precise else 0.0
    return Mark(np.array(px), max(math.hypot(sigma, asymmetric), _MIN_SIGMA_PX), score, contrast > 0), asymmetric > 0


def _without_shadow(image: NDArray[np.uint8], mark: Mark, asymmetric: bool, sought: _Sought) -> tuple[Mark, bool]:
    """Return a located mark, located again in even light if the edge of a shadow displaces it.

    The second value is whether it is less symmetric than usual, also in even light.
    """
    (x, y), radius = mark.px.tolist(), sought.size_px / 2
    reach = compared_reach_px(sought.size_px, sought.surround)
    uneven, noise = light_unevenness(image, x, y, SHAPE_CODE[sought.shape], sought.size_px, sought.arm, reach)
    if math.isinf(noise) or (uneven < _UNEVEN_CHI2 and not asymmetric):
        return mark, asymmetric
    half = math.ceil(sought.surround * radius) + _BEYOND_PX
    left, top = max(round(x) - half, 0), max(round(y) - half, 0)
    patch, centre = image[top : round(y) + half + 1, left : round(x) + half + 1], (x - left, y - top)
    shadow = find_shadow_edge(patch, centre, radius, reach, noise)
    found = _locate(even_light(patch, centre, shadow[0]), centre, sought, True) if shadow else None
    if shadow is None or found is None or isinstance(found, Failure):
        return mark, asymmetric
    again, px = found[0], found[0].px + (left, top)
    correction = math.dist(px, mark.px)
    # A mark that is less symmetric in even light was not in the light that was found.
    if again.sigma_px > mark.sigma_px + correction:
        return mark, asymmetric
    sigma_px = math.hypot(again.sigma_px * shadow[1], _SHADOW_SIGMA * correction)
    return replace(again, px=px, sigma_px=sigma_px), found[1]


def _by_clean_edges(image: NDArray[np.uint8], mark: Mark, sought: _Sought) -> Mark:
    """Return a disc, located again without its smudged or covered parts if these leave enough of its edge."""
    blur_px = measure_blur_px(image, mark.px[None], sought.size_px)
    found = centre_by_clean_edges(image, (float(mark.px[0]), float(mark.px[1])), sought.size_px / 2, blur_px)
    if found is None:
        return mark
    sigma_px = math.hypot(found[1], _SHADOW_SIGMA * math.dist(found[0], mark.px))
    return mark if sigma_px >= mark.sigma_px else replace(mark, px=found[0], sigma_px=max(sigma_px, _MIN_SIGMA_PX))


Position = tuple[tuple[float, float], float]
"""A centre (x, y) in px, and its standard deviation per axis in px."""


def _locate_disc(
    image: NDArray[np.uint8], start: tuple[float, float], size_px: float, precise: bool
) -> Position | Failure:
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
