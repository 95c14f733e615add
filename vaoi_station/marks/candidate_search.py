"""Candidate search: find positions in a reduced frame that look like a mark.

A mark is surrounded by a bare rim. Pixels without such a rim around them are skipped, and all others are correlated
with a template. The template lies within the rim, so that objects beyond the rim have no effect.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.transforms import Floats
from vaoi_station.marks.mark_shape import CROSS_ARM, Shape, coverage

SURROUND = 2.0
"""Diameter of the compared disc, divided by the size of the mark.

The disc covers the mark and the bare rim around it."""
_MIN_SIZE_PX = 5.0
_MIN_CORRELATION = 0.75
_RIM_SHARE, _RIM_PX = 0.2, 1.25
"""Distance of the rim samples from the edge of the mark, as a share of the mark's size; and its lower limit in px."""
_CORE_SHARE = 0.22
"""Distance from the centre of a mark, as a share of its size, up to which every shape is filled along the axes.

This part of the mark is called the core."""
_RING = 16
"""Number of samples on the bare rim around a mark."""
_MAX_DEVIANT = 4
"""Largest number of samples on the rim that may differ from the rest, because something covers the rim there."""
_MIN_DIFFERENCE = 8
"""Smallest accepted difference between a mark and its rim, in grey levels."""


def reduction_factor(size_px: float) -> int:
    """Return the largest power of two by which a frame can be reduced so that a mark still measures five pixels."""
    return 2 ** max(int(math.log2(size_px / _MIN_SIZE_PX)), 0) if size_px > _MIN_SIZE_PX else 1


def find_candidates(
    image: NDArray[np.uint8], shape: Shape, size_px: float, most: int = 16, *, arm: float = CROSS_ARM
) -> tuple[Floats, Floats]:
    """Find candidates for a mark in an image. The mark may be light on dark or dark on light.

    Returns at most `most` positions (k, 2) in pixels of `image`, accurate to about half a pixel, and their scores (k,)
    in 0…1, best first. `image` (h, w) is reduced so that `size_px` is at least about five; `arm` is the width of a
    cross' arm as a share of its size.
    """
    template, ring, near = _template(shape, size_px, arm)
    if min(image.shape) <= 2 * max(len(template) // 2, int(ring[0, 0])):
        return np.zeros((0, 2)), np.zeros(0)
    image = np.ascontiguousarray(image).view()
    # Numba compiles separate versions for writeable and read-only arrays, so all images are passed as read-only.
    image.flags.writeable = False
    found = _scan_candidates(image, template, ring, near, _MIN_CORRELATION, max(round(size_px / 2), 1), most)
    return found[:, :2], found[:, 2]


@lru_cache(maxsize=64)
def _template(shape: Shape, size_px: float, arm: float) -> tuple[NDArray[np.float32], NDArray[np.int_], int]:
    """Return what the search compares with each place of an image, for a mark of the given shape and size.

    These are the picture of the mark (mean 0, square sum 1), the offsets (_RING, 2) of the samples on the bare rim, and
    the distance (px) from the centre up to which the mark is filled along the axes.
    """
    side = max(2 * round(SURROUND / math.sqrt(2) * size_px / 2) + 1, 7)
    template = coverage(shape, size_px, side, arm=arm)
    template -= template.mean()
    template /= np.sqrt((template**2).sum())
    # The corners of a square lie outside the circle with the diameter of its size. The other shapes lie inside.
    outermost = size_px / 2 * (math.sqrt(2) if shape == "square" else 1)
    rim = outermost + max(_RIM_SHARE * size_px, _RIM_PX)
    angle = 2 * np.pi * np.arange(_RING) / _RING
    ring = np.rint(rim * np.stack([np.cos(angle), np.sin(angle)], -1)).astype(np.int_)
    return template, ring, max(round(_CORE_SHARE * size_px), 1)


@compiled
def _scan_candidates(
    image: NDArray[np.uint8],
    template: NDArray[np.float32],
    ring: NDArray[np.int_],
    near: int,
    least_score: float,
    apart: int,
    most: int,
) -> Floats:
    """Find pixels that differ from the rim around them and match the template: x, y and absolute correlation, (k, 3).

    At most `most` are returned, the best first, and of those within `apart` pixels along both axes only the best one.

    `template` (s, s), s odd, has mean 0 and square sum 1; `ring` (_RING, 2) are the offsets of the rim in whole pixels,
    the first one along x; `near` is the distance, along the axes, of four pixels that belong to the core of a mark.
    """
    h, w = image.shape
    half = template.shape[0] // 2
    reach = ring[0, 0]
    edge = max(half, reach)
    rim_below, rim_above = np.zeros(w, np.int16), np.zeros(w, np.int16)
    found, count, window = np.empty((256, 3)), 0, np.empty(template.size, np.float32)
    for y in range(edge, h - edge):
        # Three tests follow, each slower than the previous one. Most pixels fail the first test, which is vectorised.
        _contrast_line(image, y, edge, reach, near, rim_below, rim_above)
        for x in range(edge, w - edge):
            if rim_below[x - edge] == 0 and rim_above[x - edge] == 0:
                continue
            if not _has_bare_rim(image, x, y, ring, rim_below[x - edge], rim_above[x - edge]):
                continue
            score = _correlation(image, template, x - half, y - half, window)
            if score < least_score:
                continue
            # The buffer doubles when full: a frame with texture can have far more hits than marks.
            if count == len(found):
                larger = np.empty((2 * count, 3))
                for n in range(count):
                    larger[n, 0], larger[n, 1], larger[n, 2] = found[n, 0], found[n, 1], found[n, 2]
                found = larger
            found[count, 0], found[count, 1], found[count, 2] = x, y, score
            count += 1
    return _best_apart(found, count, apart, most)


@inlined
def _best_apart(found: Floats, count: int, apart: int, most: int) -> Floats:
    """Return at most `most` of the first `count` places, the best first, of close ones the best; scores are erased."""
    best = np.empty((most, 3))
    for k in range(most):
        top = 0
        for n in range(count):
            if found[n, 2] > found[top, 2]:
                top = n
        if count == 0 or found[top, 2] <= 0:
            return best[:k]
        best[k, 0], best[k, 1], best[k, 2] = found[top, 0], found[top, 1], found[top, 2]
        for n in range(count):
            if abs(found[n, 0] - best[k, 0]) <= apart and abs(found[n, 1] - best[k, 1]) <= apart:
                found[n, 2] = 0.0
    return best


@inlined
def _contrast_line(
    image: NDArray[np.uint8],
    y: int,
    edge: int,
    reach: int,
    near: int,
    rim_below: NDArray[np.int16],
    rim_above: NDArray[np.int16],
) -> None:
    """Test one line of pixels for a contrast between core and rim, with four samples on the rim and five in the core.

    A pixel passes if at least three rim samples are darker than all core samples, or if at least three are lighter. For
    a pixel that passes, `rim_below` is the grey level that the rim must not exceed, or `rim_above` the level that it
    must reach. Otherwise both are 0.
    """
    last = image.shape[1] - edge
    core, over, under = image[y, edge:last], image[y - near, edge:last], image[y + near, edge:last]
    one, two = image[y, edge - near : last - near], image[y, edge + near : last + near]
    top, bottom = image[y - reach, edge:last], image[y + reach, edge:last]
    left, right = image[y, edge - reach : last - reach], image[y, edge + reach : last + reach]
    for x in range(last - edge):
        # The third of four sorted values, computed with min and max only, because these can be vectorised and a sort
        # cannot.
        a, b = min(left[x], right[x]), max(left[x], right[x])
        c, d = min(top[x], bottom[x]), max(top[x], bottom[x])
        least, most = np.int16(min(max(a, c), b, d)), np.int16(max(min(b, d), a, c))
        darkest = np.int16(min(core[x], one[x], two[x], over[x], under[x]))
        lightest = np.int16(max(core[x], one[x], two[x], over[x], under[x]))
        below, above = np.int16(darkest - _MIN_DIFFERENCE), np.int16(lightest + _MIN_DIFFERENCE)
        rim_below[x] = below if most <= below else np.int16(0)
        rim_above[x] = above if least >= above else np.int16(0)


@inlined
def _has_bare_rim(
    image: NDArray[np.uint8], x: int, y: int, ring: NDArray[np.int_], rim_below: int, rim_above: int
) -> bool:
    """Return whether nearly all samples on the rim are at most `rim_below`, or at least `rim_above` if that is 0."""
    deviant = 0
    for k in range(_RING):
        v = image[y + ring[k, 1], x + ring[k, 0]]
        deviant += v > rim_below if rim_below else v < rim_above
        if deviant > _MAX_DEVIANT:
            return False
    return True


@inlined
def _correlation(
    image: NDArray[np.uint8], template: NDArray[np.float32], left: int, top: int, window: NDArray[np.float32]
) -> float:
    """Compute the absolute normalised correlation of a template at (left, top); `window` is work space."""
    side = template.shape[0]
    for v in range(side):
        line, part = image[top + v, left : left + side], window[v * side : (v + 1) * side]
        for u in range(side):
            part[u] = line[u]
    weights = template.ravel()
    total = square = product = np.float32(0)
    # The first pixel is subtracted, so that the sums stay small enough to be exact in single precision.
    for k in range(side * side):
        p = window[k] - window[0]
        total += p
        square += p * p
        product += weights[k] * p
    spread = square - total * total / np.float32(side * side)
    return abs(product) / np.sqrt(spread) if spread > 0.5 else 0.0
