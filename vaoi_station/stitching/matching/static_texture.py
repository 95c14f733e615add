"""Detection of texture that two frames show in the same place, or at a known distance from it."""

from __future__ import annotations

import numpy as np

from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.matching.frame_pair import FramePair
from vaoi_station.stitching.matching.link import choose_corners
from vaoi_station.stitching.matching.patches import inside_both, match_patches, patch_centres

STATIC_PX = 1.5
"""Largest distance in px between two places that count as the same: noise, and vibration of the cameras."""
_SAME_SCORE = 0.8
"""Least correlation of two patches that show the same texture."""


def shows_patches(
    a: np.ndarray, b: np.ndarray, a_px: Floats, b_px: Floats, within_px: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return (k,) whether image b shows the patches of image a, centred at a_px (k, 2), near b_px (k, 2).

    The second returned value is (k,) whether the place lies inside image b, so that the patch could be found.
    """
    corners, (shown, tested) = np.rint(a_px - 0.5).astype(np.int64), np.zeros((2, len(a_px)), dtype=np.bool_)
    inside, guess = inside_both(a.shape, b.shape, corners, patch_centres(corners) + b_px - a_px)
    if len(inside):
        m = match_patches(a, b, inside, guess)
        same = m.found & (m.score >= _SAME_SCORE) & (np.hypot(*(m.b_px - guess).T) <= within_px)
        found = dict(zip(map(tuple, inside.tolist()), same.tolist(), strict=True))
        shown = np.array([found.get((x, y), False) for x, y in corners.tolist()], dtype=np.bool_)
        tested = np.array([(x, y) in found for x, y in corners.tolist()], dtype=np.bool_)
    return shown, tested


def static_corners(pair: FramePair) -> int:
    """Return how many corners in the overlap of two frames appear in the same place in both frames."""
    box = pair.overlap()
    if box is None:
        return 0
    px = patch_centres(choose_corners(pair.a, box))
    return int(shows_patches(pair.a.grey, pair.b.grey, px, px, STATIC_PX)[0].sum()) if len(px) else 0
