"""Sub-pixel matching of many small patches at once: `refine.refine`, its verdict, and how far a match can be trusted.

With g the slopes of a patch, H = Σ g·gᵀ, and noise that was white before the blur B, a match scatters by
H⁻¹·(s²·Σ (B g)(B g)ᵀ)·H⁻¹: slopes are smooth, and smooth noise is what the blur leaves. What remains of the
difference of the two patches has v² = s²·Σ B², so s² follows from it. The structure tensor
over v² alone would be too sure by a factor of 4 to 14.
"""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.patch_tables import NOISE_SHARE, WINDOW_PX
from vaoi_station.stitching.refine import MARGIN_PX, refine

PATCH_PX = WINDOW_PX + 10
"""Side of what a patch looks at, blur included."""
REACH_PX = 6.0
"""A patch that moves further from its prediction has lost its way."""
_SETTLED_PX = 0.1
"""The last step of a patch that found its place is shorter: else a good score is that of somewhere nearby."""
_SATURATED_SHARE = 0.02
_NOISE_FLOOR = 0.5
"""Grey levels; no camera is better after rounding to whole numbers and blurring."""


@dataclass(frozen=True, eq=False)
class Matches:
    """What came of each of k patches; `found` says which can be used at all."""

    b_px: Floats
    """(k, 2) where the patches' middles are in b."""
    information: Floats
    """(k, 2, 2) inverse covariance of b_px, px⁻²."""
    score: Floats
    found: NDArray[np.bool_]


def middles(places: NDArray[np.int_]) -> Floats:
    """The middles (k, 2) of patches at whole pixels (k, 2): a patch has an even number of pixels."""
    return np.asarray(places + 0.5, dtype=np.float64)


def fits(shape: tuple[int, ...], px: Floats) -> NDArray[np.bool_]:
    """Whether patches with their middles at (k, 2) lie inside an image, with room to interpolate."""
    limit = np.array([shape[1], shape[0]]) - MARGIN_PX - 1
    return np.asarray(((px >= MARGIN_PX) & (px <= limit)).all(-1))


def match(a: NDArray[np.uint8], b: NDArray[np.uint8], places: NDArray[np.int_], guess_px: Floats) -> Matches:
    """Find patches of image a in image b.

    Args:
        a: first image.
        b: second image.
        places: (k, 2) whole pixels in a; `fits(a)`. The points that are matched are the `middles` of these patches.
        guess_px: (k, 2) where the middles are expected in b, `fits(b)`; right to a few pixels.
    """
    k = len(places)
    b_px, told = np.zeros((k, 2)), np.zeros((k, 4))
    hessian, blurred = np.zeros((k, 2, 2)), np.tile(np.eye(2), (k, 1, 1))
    at = np.ascontiguousarray(places, dtype=np.int64)
    guess = np.ascontiguousarray(guess_px, dtype=np.float64)
    refine(_frozen(a), _frozen(b), at, guess, REACH_PX, b_px, hessian, blurred, told)
    score, left, last_step, saturated = told.T
    near = np.abs(b_px - guess).max(-1) <= REACH_PX
    found = near & (last_step <= _SETTLED_PX) & (saturated <= _SATURATED_SHARE)
    return Matches(b_px, _information(hessian, blurred, np.maximum(left, _NOISE_FLOOR)), score, found)


def _information(hessian: Floats, blurred: Floats, noise: Floats) -> Floats:
    """Inverse covariance (k, 2, 2), from sums over slopes and the scatter after the blur (k,) in grey levels."""
    spread = blurred * (noise**2 / NOISE_SHARE)[:, None, None]
    return np.asarray(hessian @ np.linalg.inv(spread + 1e-9 * np.eye(2)) @ hessian)


def _frozen(image: NDArray[np.uint8]) -> NDArray[np.uint8]:
    """A read-only view: frames in the ring are, and a function is compiled for each kind of array it meets."""
    view = np.ascontiguousarray(image).view()
    view.flags.writeable = False
    return view
