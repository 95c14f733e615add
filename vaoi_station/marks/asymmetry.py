"""Asymmetry of a mark: it limits the error of the centre if a cover, a smudge or glare disturbs the mark.

A mark and the bare rim around it are point symmetric: a rotation by 180° about the centre does not change them. If the
image is less symmetric than vignetting explains, the fitted centre may have a larger error than noise causes.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled

_SECTORS = 4
"""Number of octants in the upper half of the mark. Each is compared with the opposite octant."""
_EDGE_PX = 2.0
"""Distance outside a mark's edge at which its blur ends."""
_RIM_PX, _RIM = 3.0, 0.25
"""Width of the rim that is compared, px, and the upper limit of this width as a share of the mark's radius."""
_NORMAL_SHIFT, _NORMAL_SHIFT_NOISE = 0.006, 3.0
"""Largest asymmetry of an undisturbed mark: as a share of its size, and in standard deviations of its centre.

Without noise it is 0.003 in the films from photographs, and 0.004 in those of the twin."""
_NORMAL_LIGHT, _NORMAL_LIGHT_NOISE = 0.015, 1.0
"""Largest asymmetry of an undisturbed rim: as a share of the contrast, and the same per px of the centre's sigma.

It is 0.008 in the films from photographs, and 0.011 in those of the twin, with their noise."""
_SHIFT_PER_LIGHT = 0.2
"""Displacement of the centre, as a share of the radius, if the asymmetry of the rim equals the contrast. The value was
measured with light spots beside marks."""
_SIGMA_PER_NOISE = 1.5
"""Standard deviation of a fitted centre for noise equal to the contrast, px, times the square root of the radius in px.

It is 1.1 to 1.3 for sharp discs; more is allowed for blurred ones."""
_LEAST_FLAT_PX = 40
"""Least number of pixels away from the edge from which the noise is estimated."""
_COMMON_FACTOR = 2.0
"""Factor on the standard deviation, which corrects for correlated errors.

A cover or glare displaces all detections of a fiducial in the same way, but the adjustment treats detections as
independent."""


def asymmetry_sigma_px(
    image: NDArray[np.uint8], px: tuple[float, float], size_px: float, contrast: float, sigma_px: float
) -> float:
    """Estimate the standard deviation per axis (px) of a centre due to covers and glare; 0 for an undisturbed mark.

    `image` (h, w) should hold the mark and some pixels around it, `contrast` is mark minus ground in grey levels, and
    `sigma_px` the standard deviation of the centre `px` by noise.
    """
    radius = size_px / 2
    reach = radius + _EDGE_PX + min(_RIM_PX, _RIM * radius)
    odd, light, noise = measure_asymmetry(image, *px, radius, reach, contrast)
    # Only asymmetry beyond that of undisturbed marks counts, because `sigma_px` already contains the noise. A glint
    # increases the residuals of the fit, and with them `sigma_px`. The noise between neighbouring pixels limits it.
    by_noise_px = min(sigma_px, _SIGMA_PER_NOISE * noise / math.sqrt(radius))
    covered = max(odd - _NORMAL_SHIFT * size_px - _NORMAL_SHIFT_NOISE * by_noise_px, 0.0)
    glare = _SHIFT_PER_LIGHT * radius * max(light - _NORMAL_LIGHT - _NORMAL_LIGHT_NOISE * by_noise_px, 0.0)
    return _COMMON_FACTOR * math.hypot(covered, glare)


@compiled
def measure_asymmetry(
    image: NDArray[np.uint8], x: float, y: float, radius: float, reach: float, contrast: float
) -> tuple[float, float, float]:
    """Measure the asymmetry of a mark, as a shift of its centre in px, and of its rim, as a share of the contrast.

    The third value is the noise as a share of the contrast; infinite if too few pixels are away from the edge. `reach`
    is the outer radius of the compared rim, px.

    In each sector, the excess of light over the opposite sector, divided by the contrast and the arc length, is a
    displacement of the edge. A shift t of the whole mark gives t·cos θ in a sector at angle θ, and t/√2 as the root
    mean square of all sectors. The asymmetry of the rim follows likewise from mean differences.
    """
    excess, light, count = np.zeros(_SECTORS), np.zeros(_SECTORS), np.zeros(_SECTORS)
    edge, noise, flat = radius + _EDGE_PX, 0.0, 0
    for row in range(max(math.ceil(y - reach), 1), min(math.floor(y), image.shape[0] - 2) + 1):
        v = row - y
        # The opposite point (x − u, y − v) lies between pixels, so it is interpolated bilinearly.
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
            # Two comparisons give the octant and save an arc tangent per pixel.
            sector = (1 if u > 0 else 0) + (2 if abs(u) > abs(v) else 0)
            if r < edge:
                excess[sector] += min(edge - r, 1.0) * off
            else:
                light[sector] += off
                count[sector] += 1
            if abs(r - radius) > _EDGE_PX + 1:
                # The mixed difference of four neighbours does not depend on gradients of the light.
                over = float(image[row - 1, column]) - image[row - 1, column - 1]
                noise += abs(over - image[row, column] + image[row, column - 1]) / 2
                flat += 1
    arc = math.pi * radius / _SECTORS
    of_mark = of_rim = 0.0
    for k in range(_SECTORS):
        of_mark += excess[k] ** 2 / _SECTORS
        of_rim += (light[k] / max(count[k], 1.0)) ** 2 / _SECTORS
    odd = math.sqrt(2 * of_mark) / (2 * abs(contrast) * arc)
    bright = math.sqrt(2 * of_rim) / (2 * abs(contrast))
    # For normally distributed values the mean absolute value is √(2/π) of the standard deviation.
    known = flat >= _LEAST_FLAT_PX
    return odd, bright, math.sqrt(math.pi / 2) * noise / flat / abs(contrast) if known else np.inf
