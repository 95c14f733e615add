"""Match many small patches of two images at once, and state the accuracy of each match.

Let g be the slopes of a patch, H = Σ g·gᵀ, B the blur, and let the noise be white with variance s² before the blur.
A match then scatters by H⁻¹·(s²·Σ (B g)(B g)ᵀ)·H⁻¹: slopes are smooth, and the blur leaves smooth noise. The remaining
difference of the two patches has the variance v² = s²·Σ B², which gives s². The structure tensor over v² alone
overestimates the accuracy by a factor of 4 to 14.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.matching.patch_tables import NOISE_SHARE, WINDOW_PX
from vaoi_station.stitching.matching.prepared_frame import read_only
from vaoi_station.stitching.matching.refinement import MARGIN_PX, Refinement, refine

PATCH_PX = WINDOW_PX + 10
"""Side of the square that a patch depends on, blur included."""
REACH_PX = 6.0
"""A match further from its prediction is discarded."""
_SETTLED_PX = 0.1
"""Longest last step of a match that converged; after a longer one the score is that of a place nearby."""
_SATURATED_SHARE = 0.02
"""Largest share of saturated pixels: they do not move with the texture."""
_NOISE_FLOOR = 0.5
"""Least noise in grey levels after rounding to whole numbers and blurring."""
_TINY = 1e-9
"""Added to the covariance of slopes, so that it can be inverted where it is 0."""


@dataclass(frozen=True, eq=False)
class Matches:
    """The results for k patches."""

    b_px: Floats
    """(k, 2) centres of the patches in b."""
    information: Floats
    """(k, 2, 2) inverse covariance of b_px, px⁻²."""
    sigma_px: Floats
    """(k,) standard deviation in the least certain direction."""
    score: Floats
    """(k,) correlation."""
    found: NDArray[np.bool_]
    """(k,) whether the other values can be used."""


def patch_centres(corners: NDArray[np.int_]) -> Floats:
    """Return the centres (k, 2) of patches at whole pixels (k, 2): half a pixel on, as their side is even."""
    return np.asarray(corners + 0.5, dtype=np.float64)


def inside_both(
    a: tuple[int, ...], b: tuple[int, ...], corners: NDArray[np.int64], guess_px: Floats
) -> tuple[NDArray[np.int64], Floats]:
    """Return the corners and guesses (k, 2) whose patches lie inside images of shapes a and b respectively."""
    return _inside_both((a[0], a[1]), (b[0], b[1]), corners, guess_px)


def match_patches(a: NDArray[np.uint8], b: NDArray[np.uint8], corners: NDArray[np.int_], guess_px: Floats) -> Matches:
    """Find patches of image a in image b.

    Args:
        a: first image.
        b: second image.
        corners: (k, 2) whole pixels in a, as of `inside_both`. What is matched are the `patch_centres`.
        guess_px: (k, 2) expected centres in b, as of `inside_both`; right to a few pixels.
    """
    # one type of each array: for another layout or a writable image a second variant would be compiled
    at = np.ascontiguousarray(corners, dtype=np.int64)
    guess = np.ascontiguousarray(guess_px, dtype=np.float64)
    refined = refine(read_only(a), read_only(b), at, guess, REACH_PX)
    found, information, sigma = _assess(guess, refined)
    return Matches(refined.b_px, information, sigma, refined.score, found)


@compiled
def _assess(guess_px: Floats, refined: Refinement) -> tuple[NDArray[np.bool_], Floats, Floats]:
    """Return which patches were found (k,), inverse covariances (k, 2, 2), and the largest sigma of each (k,)."""
    b_px, hessian, blurred = refined.b_px, refined.hessian, refined.blurred
    k = len(guess_px)
    found, information, sigma = np.zeros(k, np.bool_), np.zeros((k, 2, 2)), np.full(k, np.inf)
    for n in range(k):
        off = max(abs(b_px[n, 0] - guess_px[n, 0]), abs(b_px[n, 1] - guess_px[n, 1]))
        settled = refined.last_step_px[n] <= _SETTLED_PX
        found[n] = off <= REACH_PX and settled and refined.saturated[n] <= _SATURATED_SHARE
        noise = max(refined.scatter[n], _NOISE_FLOOR)
        share = noise * noise / NOISE_SHARE
        p, q, r = blurred[n, 0, 0] * share + _TINY, blurred[n, 0, 1] * share, blurred[n, 1, 1] * share + _TINY
        # the inverse of s²·Σ (B g)(B g)ᵀ is (a, b; b, c) / d
        a, b, c, d = r, -q, p, p * r - q * q
        xx, xy, yy = hessian[n, 0, 0], hessian[n, 0, 1], hessian[n, 1, 1]
        along_x = (xx * (xx * a + xy * b) + xy * (xx * b + xy * c)) / d
        along_y = (xy * (xy * a + yy * b) + yy * (xy * b + yy * c)) / d
        cross = (xx * (xy * a + yy * b) + xy * (xy * b + yy * c)) / d
        information[n, 0, 0], information[n, 1, 1] = along_x, along_y
        information[n, 0, 1] = information[n, 1, 0] = cross
        # the smaller eigenvalue of the information matrix
        least = (along_x + along_y) / 2 - math.hypot((along_x - along_y) / 2, cross)
        sigma[n] = 1 / math.sqrt(max(least, 1e-9))
    return found, information, sigma


@compiled
def _inside_both(
    a: tuple[int, int], b: tuple[int, int], corners: NDArray[np.int64], guess_px: Floats
) -> tuple[NDArray[np.int64], Floats]:
    keep = np.zeros(len(corners), np.bool_)
    for n in range(len(corners)):
        x, y = corners[n, 0] + 0.5, corners[n, 1] + 0.5
        u, v = guess_px[n, 0], guess_px[n, 1]
        inside = min(x, y) >= MARGIN_PX and x <= a[1] - MARGIN_PX - 1 and y <= a[0] - MARGIN_PX - 1
        keep[n] = inside and min(u, v) >= MARGIN_PX and u <= b[1] - MARGIN_PX - 1 and v <= b[0] - MARGIN_PX - 1
    return corners[keep], guess_px[keep]
