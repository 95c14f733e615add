"""Is a mark all there? A cover, a smudge or glare moves the centre further than its noise tells; compiled.

Every mark is point symmetric, and so is the bare rim around it: where they differ from themselves turned by 180° about
the centre, by more than vignetting makes them, the centre may be off.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled

_SECTORS = 4
"""Of the upper half: octants, which are compared with those that face them."""
_EDGE_PX = 2.0
"""So far outside a mark's edge its blur ends."""
_RIM_PX, _RIM = 3.0, 0.25
"""Width of the rim that is looked at: so many px, at most that share of the radius."""
_ODD, _ODD_NOISE = 0.01, 3.0
"""Oddness that marks have by themselves: in sizes, and in standard deviations of the centre."""
_LIGHT, _LIGHT_NOISE = 0.03, 2.0
"""The same for the light on the rim: in contrasts, and in contrasts per px of the centre's standard deviation."""
_PULL = 0.2
"""By such a share of the radius is the centre off when the light on the rim differs by the whole contrast, as spots of
light beside marks showed."""
_IN_COMMON = 2.0
"""What lies on one fiducial lies on it in every frame, and lamps shine on all alike: it does not average out over
sightings, which the adjustment takes to be independent."""


def asymmetry_sigma_px(
    image: NDArray[np.uint8], px: tuple[float, float], size_px: float, contrast: float, sigma_px: float
) -> float:
    """Standard deviation of a centre per axis (px) by what covers the mark or shines on it; 0 for one that is whole.

    Args:
        image: (h, w); the mark and some pixels around it should lie inside.
        px: the centre that was fitted.
        size_px: diameter of the mark.
        contrast: between mark and ground, grey levels.
        sigma_px: standard deviation of the centre by noise.
    """
    radius = size_px / 2
    odd, light = measure_asymmetry(image, *px, radius, radius + _EDGE_PX + min(_RIM_PX, _RIM * radius), contrast)
    covered = max(odd - _ODD * size_px - _ODD_NOISE * sigma_px, 0.0)
    shone_on = _PULL * radius * max(light - _LIGHT - _LIGHT_NOISE * sigma_px, 0.0)
    return _IN_COMMON * math.hypot(covered, shone_on)


@compiled
def measure_asymmetry(
    image: NDArray[np.uint8], x: float, y: float, radius: float, reach: float, contrast: float
) -> tuple[float, float]:
    """How far the two sides of a mark are from facing each other, as a shift of its centre in px; and those of its rim.

    In every sector the light in excess of the opposite sector's, over the contrast and the length of the arc, is the
    distance by which the edge would have to be displaced. A shift t of the whole mark leaves t·cos θ in a sector at θ,
    t/√2 in the root mean square. Of the rim outside it is the mean difference, over the contrast, likewise.

    Args:
        image: (h, w).
        x: of the centre, px.
        y: of the centre, px.
        radius: of the mark, px.
        reach: to where the rim is compared, px.
        contrast: between mark and ground, grey levels.
    """
    excess, light, count = np.zeros(_SECTORS), np.zeros(_SECTORS), np.zeros(_SECTORS)
    edge = radius + _EDGE_PX
    for row in range(max(math.ceil(y - reach), 1), min(math.floor(y), image.shape[0] - 2) + 1):
        v = row - y
        i = math.floor(y - v)
        down = y - v - i
        for column in range(max(math.ceil(x - reach), 1), min(math.floor(x + reach), image.shape[1] - 2) + 1):
            u = column - x
            r = math.sqrt(u * u + v * v)
            j = math.floor(x - u)
            if r > reach or i < 0 or j < 0 or i > image.shape[0] - 2 or j > image.shape[1] - 2:
                continue
            across = x - u - j
            above = image[i, j] * (1 - across) + image[i, j + 1] * across
            below = image[i + 1, j] * (1 - across) + image[i + 1, j + 1] * across
            off = image[row, column] - above * (1 - down) - below * down
            sector = (1 if u > 0 else 0) + (2 if abs(u) > abs(v) else 0)
            if r < edge:
                excess[sector] += min(edge - r, 1.0) * off
            else:
                light[sector] += off
                count[sector] += 1
    arc = math.pi * radius / _SECTORS
    odd = math.sqrt(2 * (excess**2).mean()) / (2 * abs(contrast) * arc)
    return odd, math.sqrt(2 * ((light / np.maximum(count, 1.0)) ** 2).mean()) / (2 * abs(contrast))
