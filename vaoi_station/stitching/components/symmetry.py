"""Find the centre of a component in a frame, as the centre about which its picture is point symmetric.

Chips and most packages with leads look alike if they are turned by 180° about their centre: body, leads, pads and
solder. The patch around a component is correlated with itself turned by 180°. The highest correlation gives the centre
of symmetry without a model of the component. Markings and neighbours are not symmetric; they reduce the correlation.
"""

from __future__ import annotations

import math

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.components.part_views import reduced_patch, reduction

_MARGIN_MM = 0.1
"""Width of the rim around a footprint that is compared too: it contains the edges of pads and body.

A rim of 0.3 mm contained the silkscreen of neighbours: chips at the ends of a row were found up to 0.1 mm off."""
REACH_MM = 0.3
"""Largest distance, along each axis, of a centre of symmetry from its predicted place."""
_MOST_NODES, _MOST_REDUCED = 40, 5
"""Half the side of a compared patch in nodes, at most, and the largest factor by which a frame is reduced for it.

With 20 nodes a chip 0805 at 15 px/mm had nodes of 0.2 mm, too coarse for the gap to its neighbour."""
_LEAST_SCORE, _LEAST_CONTRAST = 0.6, 4.0
"""Least correlation of a patch with itself turned by 180°, and least standard deviation of its grey levels."""


def centre_of_symmetry(
    grey: NDArray[np.uint8], px: Floats, half_px: Floats, px_per_mm: float
) -> tuple[float, float] | None:
    """Return how far the centre of symmetry of a component lies from its predicted place, px.

    Args:
        grey: (h, w) the frame.
        px: (2,) the predicted place of the component's centre, raw pixels.
        half_px: (2,) half the extent of its footprint along the image's axes.
        px_per_mm: resolution.

    Returns:
        The distance along x and y; None if the component is too large, too near to the border, or not symmetric.
    """
    half = half_px + _MARGIN_MM * px_per_mm
    factor = reduction(half, _MOST_NODES)
    if factor > _MOST_REDUCED:
        return None
    # A displacement of the centre by one node displaces the turned patch by two.
    reach = max(math.ceil(2 * REACH_MM * px_per_mm / factor), 2)
    patch = reduced_patch(grey, px, np.ceil(half / factor).astype(int) + reach, factor)
    if patch is None:
        return None
    turned = np.ascontiguousarray(patch[::-1, ::-1][reach:-reach, reach:-reach])
    if turned.std() < _LEAST_CONTRAST:
        return None
    score = cv2.matchTemplate(patch, turned, cv2.TM_CCOEFF_NORMED)
    row, column = divmod(int(score.argmax()), score.shape[1])
    inside = 0 < row < len(score) - 1 and 0 < column < score.shape[1] - 1
    if not inside or score[row, column] < _LEAST_SCORE:
        return None
    x = column - reach + _vertex(score[row, column - 1 : column + 2])
    y = row - reach + _vertex(score[row - 1 : row + 2, column])
    middle = np.rint(px)
    return float(factor * x / 2 + middle[0] - px[0]), float(factor * y / 2 + middle[1] - px[1])


def _vertex(values: NDArray[np.float32]) -> float:
    """Return the place of the maximum of the parabola through three values at −1, 0 and 1."""
    before, top, after = (float(v) for v in values)
    bend = before - 2 * top + after
    return 0.5 * (before - after) / bend if bend < 0 else 0.0
