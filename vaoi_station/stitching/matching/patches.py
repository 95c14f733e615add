"""Match many small patches of two images at once, and estimate the accuracy of each match.

Let g (2,) be the slopes of a patch in x and y at one pixel, Σ a sum over the pixels of the patch, H = Σ g·gᵀ, and B the
blur. Let the noise before the blur be white noise with variance s². The covariance of a match is then H⁻¹·(s²·Σ (B g)(B
g)ᵀ)·H⁻¹. The difference that remains between the two matched patches has the variance v² = s²·Σ B², from which s²
follows. The simpler estimate v²·H⁻¹ would treat blurred noise as white noise. Its variances are too small by a factor
of 4 to 14.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.matching.frames import read_only
from vaoi_station.stitching.matching.refinement import MARGIN_PX, NOISE_SHARE, Refinement, refine

REACH_PX = 6.0
"""Largest distance of a match from its predicted position, in x and in y; a match further away is discarded."""
_SETTLED_PX = 0.1
"""A match has converged if its last step was at most this, px. Otherwise its score belongs to another position."""
_SATURATED_SHARE = 0.02
"""Largest share of saturated pixels in a match; more would spoil it, because they do not move with the texture."""
_NOISE_FLOOR = 0.5  # smallest noise that is assumed after the blur, in grey levels: pixels are rounded to whole numbers
_TINY = 1e-9
"""Small number, added to the diagonal of a covariance (2, 2), so that it can be inverted even where it is 0."""


@dataclass(frozen=True, eq=False)
class Matches:
    """The matches of k patches of image a in image b."""

    b_px: Floats  # (k, 2) measured centres of the patches in image b, px
    information: Floats  # (k, 2, 2) inverse covariance of b_px, px⁻²
    sigma_px: Floats  # (k,) standard deviation of b_px in the direction in which it is largest
    score: Floats  # (k,) correlation of the matched patches; 0 for a lost patch
    found: NDArray[np.bool_]  # (k,) whether the patch was found; only then the other values can be used


def patch_centres(corners: NDArray[np.int_]) -> Floats:
    """Return the centres (k, 2) of the patches at corners (k, 2), which are whole pixels.

    The side of a patch is even: its centre lies half a pixel to the right of its corner and below it.
    """
    return np.asarray(corners + 0.5, dtype=np.float64)


def are_inside_both(
    a: tuple[int, ...], b: tuple[int, ...], corners: NDArray[np.int64], guess_px: Floats
) -> NDArray[np.bool_]:
    """Return (k,) whether the patches at corners (k, 2) of image a and their guesses in image b lie inside the images.

    `a` and `b` are the shapes of the images.
    """
    both = np.hstack([patch_centres(corners), guess_px])
    last = np.array([a[1], a[0], b[1], b[0]]) - (MARGIN_PX + 1)
    return np.asarray(((both >= MARGIN_PX) & (both <= last)).all(1))


def match_patches(a: NDArray[np.uint8], b: NDArray[np.uint8], corners: NDArray[np.int_], guess_px: Floats) -> Matches:
    """Find patches of image a in image b.

    Args:
        a: first image.
        b: second image.
        corners: (k, 2) whole pixels in image a that pass `are_inside_both`; patches are centred at `patch_centres`.
        guess_px: (k, 2) predicted centres in image b, accurate to a few pixels.
    """
    # Numba would compile a second variant for another memory layout or for a writable image
    at = np.ascontiguousarray(corners, dtype=np.int64)
    guess = np.ascontiguousarray(guess_px, dtype=np.float64)
    refined = refine(read_only(a), read_only(b), at, guess, REACH_PX)
    found, information, sigma = _assess(guess, refined)
    return Matches(refined.b_px, information, sigma, refined.score, found)


@compiled
def _assess(guess_px: Floats, refined: Refinement) -> tuple[NDArray[np.bool_], Floats, Floats]:
    """Return for each patch whether it was found, its information matrix (2, 2), and its largest standard deviation."""
    b_px, hessian, blurred = refined.b_px, refined.hessian, refined.blurred
    k = len(guess_px)
    found, information, sigma = np.zeros(k, np.bool_), np.zeros((k, 2, 2)), np.empty(k)
    for n in range(k):
        off = max(abs(b_px[n, 0] - guess_px[n, 0]), abs(b_px[n, 1] - guess_px[n, 1]))
        settled = refined.last_step_px[n] <= _SETTLED_PX
        found[n] = off <= REACH_PX and settled and refined.saturated[n] <= _SATURATED_SHARE
        noise = max(refined.scatter[n], _NOISE_FLOOR)
        share = noise * noise / NOISE_SHARE
        p, q, r = blurred[n, 0, 0] * share + _TINY, blurred[n, 0, 1] * share, blurred[n, 1, 1] * share + _TINY
        # s²·Σ (B g)(B g)ᵀ = (p, q; q, r), and its inverse is (a, b; b, c) / d
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
