"""The paper's localisation of a mark (section 3.2): template matching, thresholding, centre of gravity.

It is only a baseline for benchmarks: shading over the mark and copper beside it displace the centre of gravity.
"""

from __future__ import annotations

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.marks.mark_shape import Shape, coverage

_MIN_CORRELATION = 0.6


def locate_by_centre_of_gravity(
    image: NDArray[np.uint8],
    near_px: Floats,
    shape: Shape,
    size_px: float,
    *,
    light: bool,
    reach_px: float = 20.0,
) -> Floats | Failure:
    """Locate a mark with the paper's method, and return its centre (2,) in raw pixels.

    `image` (h, w) is the full frame, `near_px` (2,) the predicted position, `light` whether the mark is lighter than
    its surroundings, and `reach_px` the largest accepted distance from the prediction along each axis.
    """
    side = 2 * int(np.ceil(0.6 * size_px)) + 1
    half = side // 2 + int(np.ceil(reach_px))
    x, y = (round(float(v)) for v in near_px)
    low = max(x - half, 0), max(y - half, 0)
    patch = image[low[1] : y + half + 1, low[0] : x + half + 1]
    if min(patch.shape) < side:
        return Failure(f"the mark near ({x}, {y}) px is cut off by the frame's border")
    template = np.round(coverage(shape, size_px, side) * (200 if light else -200) + (20 if light else 220))
    # The grey levels of the template are arbitrary, because the normalised correlation ignores gain and offset.
    surface = cv2.matchTemplate(patch, template.astype(np.uint8), cv2.TM_CCOEFF_NORMED)
    _, score, _, (left, top) = cv2.minMaxLoc(surface)
    # `not >=` also catches NaN, which is the correlation of a constant window.
    if not score >= _MIN_CORRELATION:
        return Failure(f"correlation {score:.2f} near ({x}, {y}) px is below {_MIN_CORRELATION}")
    window = patch[top : top + side, left : left + side]
    kind = cv2.THRESH_BINARY if light else cv2.THRESH_BINARY_INV
    _, mask = cv2.threshold(np.ascontiguousarray(window), 0, 1, kind | cv2.THRESH_OTSU)
    v, u = np.nonzero(mask)
    if not len(u):
        return Failure(f"no pixel is above the threshold near ({x}, {y}) px")
    return np.array([low[0] + left + u.mean(), low[1] + top + v.mean()])
