"""Candidate search: find positions in a reduced frame that look like a mark.

A mark is surrounded by a bare rim. Pixels without such a rim around them are skipped (`candidate_kernels`), and all
others are correlated with a template. The template lies within the rim, so that objects beyond the rim have no effect.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats
from vaoi_station.marks.candidate_kernels import RING, scan_candidates
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
    hits = scan_candidates(image, template, ring, near, _MIN_CORRELATION)
    hits = hits[np.argsort(-hits[:, 2], kind="stable")]
    best = np.zeros((0, 3))
    while len(hits) and len(best) < most:
        best = np.vstack([best, hits[:1]])
        hits = hits[np.abs(hits[:, :2] - hits[0, :2]).max(1) > max(round(size_px / 2), 1)]
    return best[:, :2], best[:, 2]


@lru_cache(maxsize=64)
def _template(shape: Shape, size_px: float, arm: float) -> tuple[NDArray[np.float32], NDArray[np.int_], int]:
    """Return what the search compares with each place of an image, for a mark of the given shape and size.

    These are the picture of the mark (mean 0, square sum 1), the offsets (RING, 2) of the samples on the bare rim, and
    the distance (px) from the centre up to which the mark is filled along the axes.
    """
    side = max(2 * round(SURROUND / math.sqrt(2) * size_px / 2) + 1, 7)
    template = coverage(shape, size_px, side, arm=arm)
    template -= template.mean()
    template /= np.sqrt((template**2).sum())
    # The corners of a square lie outside the circle with the diameter of its size. The other shapes lie inside.
    outermost = size_px / 2 * (math.sqrt(2) if shape == "square" else 1)
    rim = outermost + max(_RIM_SHARE * size_px, _RIM_PX)
    angle = 2 * np.pi * np.arange(RING) / RING
    ring = np.rint(rim * np.stack([np.cos(angle), np.sin(angle)], -1)).astype(np.int_)
    return template, ring, max(round(_CORE_SHARE * size_px), 1)
