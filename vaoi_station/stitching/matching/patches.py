"""Sub-pixel matching of many small patches at once: `refine.refine`, its verdict, and how far a match can be trusted.

With g the slopes of a patch, H = Σ g·gᵀ, and noise that was white before the blur B, a match scatters by
H⁻¹·(s²·Σ (B g)(B g)ᵀ)·H⁻¹: slopes are smooth, and smooth noise is what the blur leaves. What remains of the
difference of the two patches has v² = s²·Σ B², so s² follows from it. The structure tensor
over v² alone would be too sure by a factor of 4 to 14.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.matching.patch_tables import NOISE_SHARE, WINDOW_PX
from vaoi_station.stitching.matching.prepared_frame import frozen
from vaoi_station.stitching.matching.refinement import MARGIN_PX, refine

PATCH_PX = WINDOW_PX + 10
"""Side of what a patch looks at, blur included."""
REACH_PX = 6.0
"""A patch that moves further from its prediction has lost its way."""
_SETTLED_PX = 0.1
"""The last step of a patch that found its place is shorter: else a good score is that of somewhere nearby."""
_SATURATED_SHARE = 0.02
_NOISE_FLOOR = 0.5
"""Grey levels; no camera is better after rounding to whole numbers and blurring."""
_NOTHING = 1e-9
"""Added to what noise makes of slopes, so that it can be divided by where there is none."""


@dataclass(frozen=True, eq=False)
class Matches:
    """What came of each of k patches; `found` says which can be used at all."""

    b_px: Floats
    """(k, 2) where the patches' middles are in b."""
    information: Floats
    """(k, 2, 2) inverse covariance of b_px, px⁻²."""
    sigma_px: Floats
    """(k,) standard deviation in the direction that is fixed worst."""
    score: Floats
    found: NDArray[np.bool_]


def middles(places: NDArray[np.int_]) -> Floats:
    """The middles (k, 2) of patches at whole pixels (k, 2): a patch has an even number of pixels."""
    return np.asarray(places + 0.5, dtype=np.float64)


def fitting(
    a: tuple[int, ...], b: tuple[int, ...], places: NDArray[np.int64], guess_px: Floats
) -> tuple[NDArray[np.int64], Floats]:
    """The places (k, 2) whose patches lie inside an image of shape a and, as guessed (k, 2), inside one of shape b."""
    return _fitting((a[0], a[1]), (b[0], b[1]), places, guess_px)


def match(a: NDArray[np.uint8], b: NDArray[np.uint8], places: NDArray[np.int_], guess_px: Floats) -> Matches:
    """Find patches of image a in image b.

    Args:
        a: first image.
        b: second image.
        places: (k, 2) whole pixels in a, `fitting`. The points that are matched are the `middles` of these patches.
        guess_px: (k, 2) where the middles are expected in b, `fitting`; right to a few pixels.
    """
    k = len(places)
    b_px, told = np.empty((k, 2)), np.zeros((k, 4))
    hessian, blurred = np.empty((k, 2, 2)), np.zeros((k, 2, 2))
    at = np.ascontiguousarray(places, dtype=np.int64)
    guess = np.ascontiguousarray(guess_px, dtype=np.float64)
    refine(frozen(a), frozen(b), at, guess, REACH_PX, b_px, hessian, blurred, told)
    found, information, sigma = _weighed(guess, b_px, hessian, blurred, told)
    return Matches(b_px, information, sigma, told[:, 0], found)


@compiled
def _weighed(
    guess_px: Floats, b_px: Floats, hessian: Floats, blurred: Floats, told: Floats
) -> tuple[NDArray[np.bool_], Floats, Floats]:
    """Which patches were found (k,), the inverse covariance (k, 2, 2) of their places, its worst sigma (k,)."""
    k = len(guess_px)
    found, information, sigma = np.zeros(k, np.bool_), np.zeros((k, 2, 2)), np.full(k, np.inf)
    for n in range(k):
        off = max(abs(b_px[n, 0] - guess_px[n, 0]), abs(b_px[n, 1] - guess_px[n, 1]))
        found[n] = off <= REACH_PX and told[n, 2] <= _SETTLED_PX and told[n, 3] <= _SATURATED_SHARE
        noise = max(told[n, 1], _NOISE_FLOOR)
        share = noise * noise / NOISE_SHARE
        p, q, r = blurred[n, 0, 0] * share + _NOTHING, blurred[n, 0, 1] * share, blurred[n, 1, 1] * share + _NOTHING
        a, b, c, d = r, -q, p, p * r - q * q  # the inverse of what noise makes is (a, b; b, c) / d
        xx, xy, yy = hessian[n, 0, 0], hessian[n, 0, 1], hessian[n, 1, 1]
        along_x = (xx * (xx * a + xy * b) + xy * (xx * b + xy * c)) / d
        along_y = (xy * (xy * a + yy * b) + yy * (xy * b + yy * c)) / d
        cross = (xx * (xy * a + yy * b) + xy * (xy * b + yy * c)) / d
        information[n, 0, 0], information[n, 1, 1] = along_x, along_y
        information[n, 0, 1] = information[n, 1, 0] = cross
        least = (along_x + along_y) / 2 - math.hypot((along_x - along_y) / 2, cross)
        sigma[n] = 1 / math.sqrt(max(least, 1e-9))
    return found, information, sigma


@compiled
def _fitting(
    a: tuple[int, int], b: tuple[int, int], places: NDArray[np.int64], guess_px: Floats
) -> tuple[NDArray[np.int64], Floats]:
    keep = np.zeros(len(places), np.bool_)
    for n in range(len(places)):
        x, y = places[n, 0] + 0.5, places[n, 1] + 0.5
        u, v = guess_px[n, 0], guess_px[n, 1]
        inside = min(x, y) >= MARGIN_PX and x <= a[1] - MARGIN_PX - 1 and y <= a[0] - MARGIN_PX - 1
        keep[n] = inside and min(u, v) >= MARGIN_PX and u <= b[1] - MARGIN_PX - 1 and v <= b[0] - MARGIN_PX - 1
    return places[keep], guess_px[keep]
