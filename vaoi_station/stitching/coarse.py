"""The coarse step: by how much the real motion differs from the nominal one, to a pixel or two.

One correlation of the overlap, high-passed and small, within the range a belt may wander.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.prepare import Prepared

_LEAST_SCORE = 0.25
_AMPLE_PX = 24
"""An overlap that is so wide even at half the size is searched there: a quarter of the work, at half as many places."""
_LEAST_CONTRAST = 1.0
"""Grey levels (rms) of texture below which an overlap counts as empty."""


@dataclass(frozen=True)
class CoarseShift:
    """Frame-b pixels to add to the nominal prediction."""

    px: Floats
    score: float


class NoFit(Failure):
    """There is texture, but it is not in the other frame."""


def find_shift(
    a: Prepared, b: Prepared, box: tuple[int, int, int, int], offset_px: Floats, reach_px: Floats
) -> CoarseShift | Failure:
    """Find how far content of frame a has moved beyond the prediction.

    Args:
        a: frame whose overlap is looked for.
        b: frame in which it is looked for.
        box: the overlap in frame a, x0, y0, x1, y1.
        offset_px: predicted b − a in the middle of the overlap, (2,).
        reach_px: how far it may be off in x and y, (2,).
    """
    f, coarse_a, coarse_b = a.factor, a.coarse, b.coarse
    if min(box[2] - box[0], box[3] - box[1]) >= _AMPLE_PX * 2 * f:
        f, coarse_a, coarse_b = 2 * f, a.coarser, b.coarser
    x0, y0, x1, y1 = (round(v / f) for v in box)
    template = coarse_a[y0:y1, x0:x1]
    if min(template.shape, default=0) < 4:
        return Failure(f"the overlap of {box[2] - box[0]}×{box[3] - box[1]} px is too narrow to search in")
    contrast = float(template.std())
    if contrast < _LEAST_CONTRAST:
        return Failure(f"the overlap is empty: contrast {contrast:.1f} grey levels")
    reach = np.maximum(np.ceil(reach_px / f).astype(int) + 1, 2)  # and one more, so that the best place has neighbours
    shift = np.round(offset_px / f).astype(int)
    window = _padded(coarse_b, x0 + shift[0], y0 + shift[1], x1 + shift[0], y1 + shift[1], reach)
    surface = cv2.matchTemplate(window, template, cv2.TM_CCORR_NORMED)
    surface = np.nan_to_num(surface, nan=0.0, posinf=0.0, neginf=0.0)
    peak = divmod(int(surface.argmax()), surface.shape[1])
    score = float(surface[peak])
    if score < _LEAST_SCORE:
        return NoFit(f"no place within ±{reach_px[0]:.0f}, ±{reach_px[1]:.0f} px fits: best correlation {score:.2f}")
    found = np.array([_vertex(surface[peak[0]], peak[1]), _vertex(surface[:, peak[1]], peak[0])])
    return CoarseShift((found - reach + shift) * f - offset_px, score)


def _padded(
    image: NDArray[np.float32], x0: int, y0: int, x1: int, y1: int, reach: NDArray[np.int_]
) -> NDArray[np.float32]:
    """A window of an image with zeros (no texture) where it reaches beyond."""
    x0, y0, x1, y1 = x0 - int(reach[0]), y0 - int(reach[1]), x1 + int(reach[0]), y1 + int(reach[1])
    h, w = image.shape
    out = np.zeros((y1 - y0, x1 - x0), dtype=np.float32)
    xa, ya, xb, yb = max(x0, 0), max(y0, 0), min(x1, w), min(y1, h)
    if xb > xa and yb > ya:
        out[ya - y0 : yb - y0, xa - x0 : xb - x0] = image[ya:yb, xa:xb]
    return out


def _vertex(line: NDArray[np.float32], k: int) -> float:
    """Position of the maximum near sample k by a parabola through its neighbours."""
    if not 0 < k < len(line) - 1:
        return float(k)
    left, mid, right = (float(v) for v in line[k - 1 : k + 2])
    bend = left - 2 * mid + right
    return k + 0.5 * (left - right) / bend if bend < 0 else float(k)
