"""Fit of the centre of point symmetry c: the point about which an image best equals itself rotated by 180°; compiled.

Gauss-Newton minimises the differences I(c + u) − I(c − u) of the image I at opposite offsets u. If the gain grows by a
share a per pixel across the mark, each difference grows by 2·a·u times the mean of both values. This term is odd in u,
like the effect of a shift. Therefore a is estimated too, so that vignetting does not displace the centre.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.marks.small_cholesky import position_variance, solve_cholesky

FITTED, UNDETERMINED, TOO_FAR = 0, 1, 2
BEFORE, AFTER = 2, 3
"""Numbers of pixels before and after a position from which its value is interpolated."""
_MAX_STEPS, _MAX_STEP_PX = 18, 1.5
_COARSE_PX, _FINE_PX = 0.05, 1e-3
"""The coarse stage and the fine stage of the fit end with a step shorter than this, px."""
_OUTLIER = 0.15
"""Differences above this share of the contrast lose weight, so that copper on one side has little effect."""


@compiled
def fit_symmetry(
    image: NDArray[np.float32], x: float, y: float, reach: int, furthest: float, coarse: int
) -> tuple[int, float, float, float]:
    """Find the centre of point symmetry near the position (x, y) in px, up to `furthest` from it along each axis.

    Returns a code (`FITTED`, `UNDETERMINED` or `TOO_FAR`), centre x and y, and the standard deviation per axis, in px.
    `image` (h, w) is smoothed so that interpolation is exact, and exceeds the compared square of half side `reach` by
    `furthest` and the pixels that interpolation needs. `coarse` is the stride of the pixels in the first stage.
    """
    side = 2 * reach + 3
    window, lines = np.empty((side, side), np.float32), np.empty((side + BEFORE + AFTER, side), np.float32)
    normal, right = np.zeros((4, 5)), np.zeros(4)
    cx, cy, noise = x, y, 0.0
    for stage in range(2):
        # The first stage estimates only the centre, on few pixels, because the gradient of the gain has little effect.
        stride, enough, unknowns = (coarse, _COARSE_PX, 2) if stage == 0 else (1, _FINE_PX, 4)
        limit = np.inf
        for step in range(_MAX_STEPS):
            _interpolate_window(image, cx, cy, reach + 1, window, lines)
            square, count = _normal_equations(window, stride, limit, normal)
            # The solution overwrites the right side, which is needed once more for the residual.
            for k in range(4):
                right[k] = normal[k, 4]
            # Along a straight edge the 2×2 matrix of the shift is singular: the aperture problem.
            if normal[0, 0] * normal[1, 1] - normal[0, 1] ** 2 < 1e-6 * (normal[0, 0] + normal[1, 1]) ** 2:
                return UNDETERMINED, cx, cy, 0.0
            if not solve_cholesky(normal, unknowns):
                return UNDETERMINED, cx, cy, 0.0
            dx, dy = normal[0, 4], normal[1, 4]
            for k in range(unknowns):
                square -= right[k] * normal[k, 4]
            noise = math.sqrt(max(square, 0.0) / max(count - unknowns, 1.0))
            cx -= min(max(dx, -_MAX_STEP_PX), _MAX_STEP_PX)
            cy -= min(max(dy, -_MAX_STEP_PX), _MAX_STEP_PX)
            if max(abs(cx - x), abs(cy - y)) > furthest:
                return TOO_FAR, cx, cy, 0.0
            if max(abs(dx), abs(dy)) < enough and step > stage:
                break
            if stage == 1:
                low = high = window[0, 0]
                for i in range(side):
                    for j in range(side):
                        low, high = min(low, window[i, j]), max(high, window[i, j])
                limit = max(3 * noise, _OUTLIER * (high - low))
    return FITTED, cx, cy, noise * math.sqrt(position_variance(normal))


@inlined
def _normal_equations(
    window: NDArray[np.float32], stride: int, limit: float, normal: NDArray[np.float64]
) -> tuple[float, float]:
    """Accumulate the normal equations for the shift and the gradient of the gain, right side in column 4 of `normal`.

    Returns the weighted sum of squared differences, and the sum of weights. Differences above `limit` lose weight.
    """
    last = window.shape[0] - 1
    half = window.shape[0] // 2
    per_side = np.float32(0.5 / (half - 1))
    eighth = np.float32(0.125)
    a00 = a01 = a02 = a03 = a0e = 0.0
    a11 = a12 = a13 = a1e = a22 = a23 = a2e = a33 = a3e = 0.0
    total = count = 0.0
    steep = np.float32(1 / limit)
    # Opposite pixels give the same equation with opposite sign, so one half of the window suffices.
    for i in range(1, half + 1, stride):
        over, here, under = window[i - 1], window[i], window[i + 1]
        far_over, far, far_under = window[last - i - 1], window[last - i], window[last - i + 1]
        v = np.float32(i - half) * per_side
        end = last if i < half else half
        for j in range(1, end, stride):
            k = last - j
            # Sobel slopes of the pixel (g) and of its counterpart (h).
            gx = (over[j + 1] - over[j - 1] + 2 * (here[j + 1] - here[j - 1]) + under[j + 1] - under[j - 1]) * eighth
            gy = (under[j - 1] + 2 * under[j] + under[j + 1] - over[j - 1] - 2 * over[j] - over[j + 1]) * eighth
            hx = far_over[k + 1] - far_over[k - 1] + 2 * (far[k + 1] - far[k - 1])
            hx = (hx + far_under[k + 1] - far_under[k - 1]) * eighth
            hy = far_under[k - 1] + 2 * far_under[k] + far_under[k + 1]
            hy = (hy - far_over[k - 1] - 2 * far_over[k] - far_over[k + 1]) * eighth
            e, both = here[j] - far[k], here[j] + far[k]
            weight = 1 / (1 + (e * steep) ** 2)
            root = math.sqrt(weight)
            e *= root
            c0, c1 = (gx - hx) * root, (gy - hy) * root
            c2, c3 = np.float32(j - half) * per_side * both * root, v * both * root
            count += weight
            a00 += c0 * c0
            a01 += c0 * c1
            a02 += c0 * c2
            a03 += c0 * c3
            a0e += c0 * e
            a11 += c1 * c1
            a12 += c1 * c2
            a13 += c1 * c3
            a1e += c1 * e
            a22 += c2 * c2
            a23 += c2 * c3
            a2e += c2 * e
            a33 += c3 * c3
            a3e += c3 * e
            total += e * e
    normal[0, 0], normal[0, 1], normal[0, 2], normal[0, 3], normal[0, 4] = a00, a01, a02, a03, a0e
    normal[1, 1], normal[1, 2], normal[1, 3], normal[1, 4] = a11, a12, a13, a1e
    # A constant image leaves the gradient undetermined; a tiny addend keeps the matrix positive definite.
    normal[2, 2], normal[2, 3], normal[2, 4] = a22 * (1 + 1e-6), a23, a2e
    normal[3, 3], normal[3, 4] = a33 * (1 + 1e-6), a3e
    return total, count


@inlined
def _interpolate_window(
    image: NDArray[np.float32],
    x: float,
    y: float,
    reach: int,
    window: NDArray[np.float32],
    lines: NDArray[np.float32],
) -> None:
    """Interpolate a square of 2·reach + 1 pixels, centred at (x, y), with Lagrange polynomials over six pixels.

    Bilinear interpolation has errors of opposite sign on opposite edges of a mark, which would displace the centre.
    """
    side, taps = 2 * reach + 1, BEFORE + AFTER + 1
    column, row = math.floor(x), math.floor(y)
    across, down = np.empty(taps, np.float32), np.empty(taps, np.float32)
    _lagrange_weights(x - column, across)
    _lagrange_weights(y - row, down)
    left, top = column - reach - BEFORE, row - reach - BEFORE
    # Lines are interpolated first, then columns. The six terms are written out, so that the inner loops vectorise.
    for i in range(side + taps - 1):
        line, out = image[top + i, left : left + side + taps - 1], lines[i]
        for j in range(side):
            out[j] = (
                across[0] * line[j]
                + across[1] * line[j + 1]
                + across[2] * line[j + 2]
                + across[3] * line[j + 3]
                + across[4] * line[j + 4]
                + across[5] * line[j + 5]
            )
    for i in range(side):
        out = window[i]
        a, b, c, d, e, f = lines[i], lines[i + 1], lines[i + 2], lines[i + 3], lines[i + 4], lines[i + 5]
        for j in range(side):
            out[j] = down[0] * a[j] + down[1] * b[j] + down[2] * c[j] + down[3] * d[j] + down[4] * e[j] + down[5] * f[j]


@inlined
def _lagrange_weights(fraction: float, weights: NDArray[np.float32]) -> None:
    """Compute the interpolation weights of the pixels −`BEFORE` … `AFTER` at position `fraction` px after pixel 0."""
    for i in range(BEFORE + AFTER + 1):
        w = 1.0
        for j in range(BEFORE + AFTER + 1):
            if j != i:
                w *= (fraction - (j - BEFORE)) / (i - j)
        weights[i] = w
