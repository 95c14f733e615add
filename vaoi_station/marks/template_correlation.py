"""Normalised correlation of an image with the shape of a mark at a sub-pixel position; compiled."""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.marks.mark_shape import Shape

SHAPE_CODE: dict[Shape, int] = {"circle": 0, "square": 1, "diamond": 2, "cross": 3}
_EDGE_PX = 2.85
"""Width of the smooth step that models an edge of a sharp camera; its slope is that of a blur of 0.76 px."""


@compiled
def correlate_with_shape(
    image: NDArray[np.uint8], x: float, y: float, code: int, size: float, arm: float, disc: float
) -> tuple[float, float]:
    """Compare an image (h, w) with a shape (`SHAPE_CODE`) at (x, y), in a disc of diameter `disc` px.

    Returns the absolute normalised correlation, 0…1, and the contrast (mark minus ground) in grey levels. `arm` is the
    width of a cross' arm as a share of its size.
    """
    reach = 0.5 * disc + 0.5
    left, right = max(math.ceil(x - reach), 0), min(math.floor(x + reach), image.shape[1] - 1)
    top, bottom = max(math.ceil(y - reach), 0), min(math.floor(y + reach), image.shape[0] - 1)
    weights = p1 = q1 = pp = qq = pq = 0.0
    r, thin = 0.5 * size, 0.5 * size * arm
    # The shape is computed for each pixel, because a template would have to be shifted by a fraction of a pixel.
    for row in range(top, bottom + 1):
        v, line = abs(row - y), image[row]
        for column in range(left, right + 1):
            u = abs(column - x)
            far = math.sqrt(u * u + v * v)
            weight = min(reach - far, 1.0)
            if weight <= 0:
                continue
            outside = outside_shape(code, u, v, far, r, thin)
            # The edge is modelled by the smoothstep polynomial 3t² − 2t³, which is faster than erf.
            t = min(max(0.5 - outside / _EDGE_PX, 0.0), 1.0)
            q, p = t * t * (3 - 2 * t), float(line[column])
            weights += weight
            p1 += weight * p
            q1 += weight * q
            pp += weight * p * p
            qq += weight * q * q
            pq += weight * p * q
    if weights <= 0:
        return 0.0, 0.0
    covariance = pq - p1 * q1 / weights
    of_picture, of_artwork = pp - p1 * p1 / weights, qq - q1 * q1 / weights
    # The correlation is undefined if the image is constant, or if the disc lies inside the mark.
    if of_picture <= 1e-6 or of_artwork <= 1e-6:
        return 0.0, 0.0
    return abs(covariance) / math.sqrt(of_picture * of_artwork), covariance / of_artwork


@inlined
def outside_shape(code: int, u: float, v: float, far: float, r: float, thin: float) -> float:
    """Compute the distance of a point from the outline of a shape, px; negative inside, approximate outside corners.

    (u, v) are the absolute distances from the centre, `far` their length, `r` half the size of the mark and `thin` half
    the width of a cross' arm, px.
    """
    outside = max(u, v) - r
    if code == 0:
        outside = far - r
    elif code == 2:
        outside = (u + v - r) * 0.7071067811865476
    elif code == 3:
        outside = min(max(u - r, v - thin), max(u - thin, v - r))
    return outside
