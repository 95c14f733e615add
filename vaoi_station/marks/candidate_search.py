"""Where in a frame something looks like a mark, at a size where the mark is a few pixels wide.

What does not stand out from a bare rim all around is passed over (`scan`); the rest is correlated with the artwork. The
compared square is the one that fits into the bare rim, so that what lies beyond does not matter.
"""

from __future__ import annotations

import math
from functools import lru_cache

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats
from vaoi_station.marks.candidate_kernels import ring_offsets, scan_candidates, suppress_non_maxima
from vaoi_station.marks.mark_shape import CROSS_ARM, Shape, coverage

SURROUND = 2.0
"""Diameter of the compared disc in sizes of the mark: the mark, and the bare rim that board makers leave around it."""
_SMALLEST_PX = 5.0
_LEAST_SCORE = 0.75
_RIM_SHARE, _RIM_PX = 0.2, 1.25
"""How far outside a mark the rim is looked at, in sizes, and at the least."""
_CORE_SHARE = 0.22
"""Pixels so far from the centre along the axes belong to every mark, in sizes."""


def reduction_factor(size_px: float) -> int:
    """By which power of two a frame may be reduced so that the mark keeps five pixels."""
    return 2 ** max(int(math.log2(size_px / _SMALLEST_PX)), 0) if size_px > _SMALLEST_PX else 1


def find_candidates(
    image: NDArray[np.uint8], shape: Shape, size_px: float, most: int = 16, *, arm: float = CROSS_ARM
) -> tuple[Floats, Floats]:
    """Candidates for a mark, light on dark or dark on light.

    Args:
        image: (h, w), reduced so that `size_px` is at least about five.
        shape: of the mark.
        size_px: of the mark in this image.
        most: how many candidates at the most, the best first.
        arm: width of a cross' arm as a share of its size.

    Returns:
        Positions (k, 2) in pixels of `image`, good to about half a pixel, and scores (k,) in 0…1.
    """
    template, ring, near = _artwork(shape, size_px, arm)
    if min(image.shape) <= 2 * max(len(template) // 2, int(ring[0, 0])):
        return np.zeros((0, 2)), np.zeros(0)
    image = np.ascontiguousarray(image).view()
    image.flags.writeable = False  # a function is compiled anew for arrays that may be written
    hits = scan_candidates(image, template, ring, near, _LEAST_SCORE)
    hits = hits[np.argsort(-hits[:, 2], kind="stable")]
    hits = hits[suppress_non_maxima(hits, max(round(size_px / 2), 1), most)]
    return hits[:, :2], hits[:, 2]


@lru_cache(maxsize=64)
def _artwork(shape: Shape, size_px: float, arm: float) -> tuple[NDArray[np.float32], NDArray[np.int_], int]:
    """The template (of mean 0 and square sum 1), the rim around it, and how far along the axes its core reaches."""
    side = max(2 * round(SURROUND / math.sqrt(2) * size_px / 2) + 1, 7)
    template = coverage(shape, size_px, side, arm=arm)
    template -= template.mean()
    template /= np.sqrt((template**2).sum())
    outermost = size_px / 2 * (math.sqrt(2) if shape == "square" else 1)
    rim = outermost + max(_RIM_SHARE * size_px, _RIM_PX)
    return template, ring_offsets(rim), max(round(_CORE_SHARE * size_px), 1)
