"""Least-squares fit of a blurred disc to the pixels of a mark, which gives the centre of the mark; compiled.

Grey level = (ground + contrast · ½ erfc((r − R) / (√2 σ))) · (1 + gx·u + gy·v), where (u, v) is the offset of a pixel
from the centre and r its length. The unknowns are the centre, the grey levels `ground` and `contrast`, the radius R,
the blur σ and the gradient (gx, gy) of the illumination. Deviations from the model, such as the curvature of vignetting
or the real blur of a lens, are even functions about the centre. The effect of a shift is an odd function. Even and odd
functions are orthogonal, so these deviations do not displace the centre.
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.marks.small_cholesky import position_variance, solve_cholesky

FITTED, NO_EDGE, TOO_FAR = 0, 1, 2
_COARSE_STEPS = 8
_COARSE_BLUR, _COARSE_REACH, _COARSE_SAMPLES = 0.3, 1.45, 3.0
"""Values of the coarse stage of the fit.

They are the blur and the reach, both as shares of the radius, and the number of samples per radius."""
_MIN_BLUR_PX, _RIM_PX, _MAX_REACH = 0.4, 3.5, 1.9
"""Values of the fine stage of the fit.

They are the smallest blur (px), the least width of the fitted rim (px), and the largest reach divided by the radius."""
_MIN_CONTRAST = 1.0
_OUTLIER = 0.1
"""Residuals above this share of the contrast lose weight, so that a reflection or a smudge has little effect."""


@compiled
def fit_disc(
    image: NDArray[np.uint8],
    x: float,
    y: float,
    radius: float,
    furthest: float,
    stride: int,
    enough_px: float,
    most_steps: int,
) -> tuple[int, float, float, float, float, float, float, float]:
    """Fit a disc near the position (x, y) in px; the disc and its rim must lie inside the image (h, w).

    Returns a code (`FITTED`, `NO_EDGE` or `TOO_FAR`), centre x and y, standard deviation of the centre per axis,
    radius, blur σ, ground and contrast. Lengths are in px, the last two in grey levels. The centre is accepted up to
    `furthest` from (x, y). Every `stride`-th pixel of every `stride`-th line is used. The iteration ends when a step is
    shorter than `enough_px`, or after `most_steps`; an undisturbed disc takes three.
    """
    # Parameters: x, y, gx, gy (odd about the centre), then ground, contrast, radius, blur (even).
    p = np.zeros(8)
    p[0], p[1], p[6], p[7] = x, y, radius, max(_COARSE_BLUR * radius, 1.0)
    # The two systems of four equations, of the odd and of the even parameters.
    equations = np.zeros((2, 4, 5))
    side = 2 * math.ceil(_MAX_REACH * radius) + 3
    pixels = np.empty((3, min(side * side, image.size)))
    coarse = max(math.ceil(radius / _COARSE_SAMPLES), 1)
    code, noise, fine, step = FITTED, np.inf, False, 0
    # One loop for both stages, so that the parts of a step are compiled once. Coarse stage: a strongly blurred model on
    # few pixels has a wide basin of convergence. Fine stage: all parameters, on a rim of a few pixels around the disc.
    while step < (most_steps if fine else _COARSE_STEPS):
        reach, every, limit, enough = _COARSE_REACH * radius, coarse, np.inf, 0.1 * coarse
        if fine:
            reach, every, enough = min(radius + max(3 * p[7], _RIM_PX), _MAX_REACH * radius), stride, enough_px
            # Outlier weights are used from the third step on. Before that, residuals are large because of the shift.
            limit = max(3 * noise, _OUTLIER * abs(p[5])) if step > 1 else np.inf
        noise = _normal_equations(image, p, reach, every, limit, pixels, equations)
        # The first step estimates the grey levels only: without a contrast the slopes for a shift are all zero.
        if not _update(p, equations, fine or step > 0, fine):
            code = NO_EDGE
            break
        if fine:
            # Bounds keep the fit on this disc: a growing radius could otherwise reach copper next to the bare rim.
            p[6] = min(max(p[6], 0.6 * radius), 1.5 * radius)
            p[7] = min(max(p[7], _MIN_BLUR_PX), 0.5 * radius)
        if np.hypot(p[0] - x, p[1] - y) > furthest:
            code = TOO_FAR
            break
        settled = step > 1 and max(abs(equations[0, 0, 4]), abs(equations[0, 1, 4])) < enough
        step += 1
        if not fine and (settled or step == _COARSE_STEPS):
            if abs(p[5]) < _MIN_CONTRAST:
                code = NO_EDGE
                break
            fine, step, p[7] = True, 0, 1.0
        elif settled:
            break
    sigma = noise * math.sqrt(position_variance(equations[0])) if code == FITTED else 0.0
    return code, p[0], p[1], sigma, p[6], p[7], p[4], p[5]


@inlined
def _normal_equations(  # noqa: PLR0915  (sums that stay in registers)
    image: NDArray[np.uint8],
    p: NDArray[np.float64],
    reach: float,
    stride: int,
    limit: float,
    pixels: NDArray[np.float64],
    equations: NDArray[np.float64],
) -> float:
    """Accumulate the normal equations of one step, and return the standard deviation of a pixel's grey level.

    The effects of x, y, gx, gy are odd about the centre, those of ground, contrast, radius, blur are even. Odd and even
    parameters are uncorrelated, so there are two systems of four equations, with right sides in column 4. `pixels` is
    work space for the offsets and grey levels of n pixels, (3, n). Residuals above `limit` lose weight.
    """
    cx, cy, gx, gy, ground, contrast, radius, blur = p[0], p[1], p[2], p[3], p[4], p[5], p[6], p[7]
    a00 = a01 = a02 = a03 = a11 = a12 = a13 = a22 = a23 = a33 = a0e = a1e = a2e = a3e = 0.0
    b00 = b01 = b02 = b03 = b11 = b12 = b13 = b22 = b23 = b33 = b0e = b1e = b2e = b3e = 0.0
    us, vs, greys = pixels[0], pixels[1], pixels[2]
    # The pixels are gathered first, so that the compiler can vectorise the loop over them.
    count = _gather_pixels(image, cx, cy, reach, stride, us, vs, greys)
    total = weights = 0.0
    for n in range(count):
        u, v = us[n], vs[n]
        r = math.sqrt(u * u + v * v)
        z = (r - radius) / blur
        cover, bell = _edge_profile(z)
        light = 1 + gx * u + gy * v
        plain = ground + contrast * cover
        e = greys[n] - plain * light
        # Pixels at the border of the window count partly, so that the sums change smoothly with the centre.
        weight = min(reach - r, 1.0) / (1 + (e / limit) ** 2)
        # Derivative of the grey level by the radius R.
        slope = contrast * bell / blur * light
        toward = slope / max(r, 1e-9)
        a0, a1, a2, a3 = toward * u, toward * v, plain * u, plain * v
        b0, b1, b2, b3 = light, cover * light, slope, slope * z
        w0, w1, w2, w3 = weight * a0, weight * a1, weight * a2, weight * a3
        a00 += w0 * a0
        a01 += w0 * a1
        a02 += w0 * a2
        a03 += w0 * a3
        a11 += w1 * a1
        a12 += w1 * a2
        a13 += w1 * a3
        a22 += w2 * a2
        a23 += w2 * a3
        a33 += w3 * a3
        a0e += w0 * e
        a1e += w1 * e
        a2e += w2 * e
        a3e += w3 * e
        w0, w1, w2, w3 = weight * b0, weight * b1, weight * b2, weight * b3
        b00 += w0 * b0
        b01 += w0 * b1
        b02 += w0 * b2
        b03 += w0 * b3
        b11 += w1 * b1
        b12 += w1 * b2
        b13 += w1 * b3
        b22 += w2 * b2
        b23 += w2 * b3
        b33 += w3 * b3
        b0e += w0 * e
        b1e += w1 * e
        b2e += w2 * e
        b3e += w3 * e
        total += weight * e * e
        weights += weight
    odd, even = equations[0], equations[1]
    odd[0, 0], odd[0, 1], odd[0, 2], odd[0, 3], odd[0, 4] = a00, a01, a02, a03, a0e
    odd[1, 1], odd[1, 2], odd[1, 3], odd[1, 4] = a11, a12, a13, a1e
    odd[2, 2], odd[2, 3], odd[2, 4] = a22, a23, a2e
    odd[3, 3], odd[3, 4] = a33, a3e
    even[0, 0], even[0, 1], even[0, 2], even[0, 3], even[0, 4] = b00, b01, b02, b03, b0e
    even[1, 1], even[1, 2], even[1, 3], even[1, 4] = b11, b12, b13, b1e
    even[2, 2], even[2, 3], even[2, 4] = b22, b23, b2e
    even[3, 3], even[3, 4] = b33, b3e
    return math.sqrt(total / max(weights, 1.0))


@inlined
def _gather_pixels(
    image: NDArray[np.uint8],
    cx: float,
    cy: float,
    reach: float,
    stride: int,
    us: NDArray[np.float64],
    vs: NDArray[np.float64],
    greys: NDArray[np.float64],
) -> int:
    """Gather offsets and grey levels of the used pixels within `reach` of the centre, and return their count."""
    left, right = max(math.ceil(cx - reach), 0), min(math.floor(cx + reach), image.shape[1] - 1)
    top, bottom = max(math.ceil(cy - reach), 0), min(math.floor(cy + reach), image.shape[0] - 1)
    count = 0
    for row in range(top, bottom + 1, stride):
        v, line = row - cy, image[row]
        for column in range(left, right + 1, stride):
            u = column - cx
            us[count], vs[count], greys[count] = u, v, line[column]
            # The loop has no branch: each pixel is written, but a pixel out of reach is not counted and so overwritten.
            count += u * u + v * v < reach * reach
    return count


@inlined
def _edge_profile(z: float) -> tuple[float, float]:
    """Compute ½ erfc(z / √2) and the normal density at z. Beyond |z| = 4 both are constant.

    The error is about 1e-7 (Abramowitz and Stegun 7.1.26).
    """
    far = min(abs(z), 4.0)
    # exp(x) = exp(x / 64)^64, with a short series for exp(x / 64). Unlike a call of exp, this can be vectorised.
    t, q = 1 / (1 + 0.2316418882 * far), -0.5 / 64 * far * far
    e = 1 + q * (1 + q / 2 * (1 + q / 3 * (1 + q / 4 * (1 + q / 5 * (1 + q / 6)))))
    e = e * e
    e = e * e
    e = e * e
    e = e * e
    e = e * e
    density = e * e if far < 4 else 0.0
    tail = t * (0.127414796 + t * (-0.142248368 + t * (0.7107068705 + t * (-0.7265760135 + t * 0.5307027145))))
    tail *= density
    return (tail if z >= 0 else 1 - tail), 0.3989422804014327 * density


@inlined
def _update(p: NDArray[np.float64], equations: NDArray[np.float64], moves: bool, shapes: bool) -> bool:
    """Change the parameters p by one Gauss-Newton step. Return False if the equations are singular.

    The grey levels are always estimated. The centre is estimated if `moves` is true, radius and blur if `shapes` is
    true, and the gradient if both are true.
    """
    for k in range(2):
        a = equations[k]
        if k == 0 and not moves:
            continue
        if not solve_cholesky(a, 4 if shapes else 2):
            return False
        if k == 0:
            # A step of more than half a radius leaves the range in which the linearisation holds.
            share = min(1.0, 0.5 * p[6] / max(abs(a[0, 4]), abs(a[1, 4]), 1e-12))
            for n in range(4 if shapes else 2):
                p[n] += share * a[n, 4]
        else:
            p[4] += a[0, 4]
            p[5] += a[1, 4]
            # Radius and blur enter nonlinearly and are limited separately.
            if shapes:
                p[6] += min(max(a[2, 4], -0.2 * p[6]), 0.2 * p[6])
                p[7] += min(max(a[3, 4], -0.4 * p[7]), 0.4 * p[7])
    return True
