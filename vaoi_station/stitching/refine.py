"""The inner loop of matching: one patch of image a, found again in image b to a few thousandths of a pixel.

Both images are blurred by 1.2 px around the patch, which takes away most of the interpolation's pull towards whole
pixels. Inverse-compositional Gauss-Newton with gain and offset follows: first with bilinear interpolation until
it stands still, then two steps with a sinc of six points under a Kaiser window, which removes the rest.

With t the patch without its mean, g its two slopes freed of what light can explain, H = g·gᵀ, and s the window of b at
the place reached, a step is H⁻¹·(g·s) / gain, gain = (t·s) / (t·t).

**Light.** Vignetting and the fall of a lamp make a patch brighter on one side, in frame b often on the other:
a blob of 5 px then seems to move by 0.01 to 0.02 px, in all patches alike, so that it does not average out. The
slopes are therefore freed of what offset, gain and a slope of the gain across the patch can explain (1, t, t·x, t·y).
"""

from __future__ import annotations

import math

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.patch_tables import ACROSS, BLUR_REACH, DOWN, FRACTIONS, GAUSS, SINC, TAPS, TWICE, WINDOW_PX

ROOM_PX = 3
"""How far a patch may move within the tile that is cut out of b; beyond that a new tile is cut …"""
_MOST_TILES = 5
"""… so many times."""
MARGIN_PX = WINDOW_PX // 2 + TAPS // 2
"""A patch's middle keeps so far off the border of either image; what the blur wants beyond that is repeated."""
_MOST_STEPS, _STILL_PX, _LONGEST_STEP_PX, _LEAST_GAIN = 12, 0.05, 1.5, 1e-3
_LEAST_CORNER = 1e-6
"""det H / (trace H)² below which a patch is but an edge."""
_SATURATED = 254
_A_PX = WINDOW_PX + 2
_B_PX = WINDOW_PX + 2 * ROOM_PX + TAPS
_B_FIRST = ROOM_PX + TAPS // 2
"""Where in a tile of b the window's first pixel lies when it is cut."""
_PADDED_PX = WINDOW_PX + 2 * BLUR_REACH
_LEFT = WINDOW_PX // 2 - 1
_AREA = WINDOW_PX * WINDOW_PX

_Pixels = NDArray[np.uint8]
_Inverse = tuple[float, float, float, float]
"""t·t, and H⁻¹ as xx, xy, yy."""
_Plane = NDArray[np.float32]
_Patch = tuple[_Plane, _Plane, _Plane, _Plane, _Plane]
"""t, the slopes in x and y, t·x and t·y; (n,) each."""
_Float = np.float32


@compiled
def refine(
    a: _Pixels,
    b: _Pixels,
    places: NDArray[np.int64],
    guess_px: Floats,
    reach_px: float,
    b_px: Floats,
    hessian: Floats,
    blurred: Floats,
    told: Floats,
) -> None:
    """Find patches of image a in image b.

    Args:
        a: first image (h, w).
        b: second image.
        places: (k, 2) whole pixels; a patch's middle is half a pixel right of and below them.
        guess_px: (k, 2) where the middles are expected in b.
        reach_px: a patch that goes further from there is lost.
        b_px: out, (k, 2) where the middles are in b.
        hessian: out, (k, 2, 2) sums of products of the slopes g, grey levels² / px².
        blurred: out, (k, 2, 2) sums of products of B g, B the blur: what noise that was blurred makes of the slopes.
        told: out, (k, 4) correlation, scatter of what is left (grey levels), last step (px; infinite if lost), share of
            saturated pixels.
    """
    raw = np.empty((_B_PX + 2 * BLUR_REACH, _B_PX + 2 * BLUR_REACH), np.uint8)
    half_way = np.empty((_B_PX + 2 * BLUR_REACH, _B_PX), _Float)
    tile_a, tile_b = np.empty((_A_PX, _A_PX), _Float), np.empty((_B_PX, _B_PX), _Float)
    t, gx, gy = np.empty(_AREA, _Float), np.empty(_AREA, _Float), np.empty(_AREA, _Float)
    tx, ty, s = np.empty(_AREA, _Float), np.empty(_AREA, _Float), np.empty(_AREA, _Float)
    patch, factor = (t, gx, gy, tx, ty), np.zeros((4, 4))
    padded, soft_rows = np.zeros(_PADDED_PX, _Float), np.zeros((_PADDED_PX, WINDOW_PX), _Float)
    rows = np.empty((WINDOW_PX + TAPS - 1, WINDOW_PX), _Float)
    for k in range(len(places)):
        _cut(a, places[k, 0] - _LEFT - 1 - BLUR_REACH, places[k, 1] - _LEFT - 1 - BLUR_REACH, raw, _A_PX)
        _blur(raw, half_way, tile_a, _A_PX, 0.0)
        told[k, 2], told[k, 3] = np.inf, _saturated(raw, BLUR_REACH + 1)
        mean, tt, xx, xy, yy = _template(tile_a, patch, factor)
        hessian[k, 0, 0], hessian[k, 0, 1], hessian[k, 1, 0], hessian[k, 1, 1] = xx, xy, xy, yy
        determinant = xx * yy - xy * xy
        if determinant <= _LEAST_CORNER * (xx + yy) ** 2 + _LEAST_CORNER:
            b_px[k] = guess_px[k]
            continue
        inverse = (tt, yy / determinant, -xy / determinant, xx / determinant)
        px, py = guess_px[k, 0] - _LEFT - 0.5, guess_px[k, 1] - _LEFT - 0.5  # of the window's first pixel from here
        x0, y0, settled = 0, 0, False
        for _ in range(_MOST_TILES):
            x0, y0 = math.floor(px) - _B_FIRST, math.floor(py) - _B_FIRST
            _cut(b, x0 - BLUR_REACH, y0 - BLUR_REACH, raw, _B_PX)
            _blur(raw, half_way, tile_b, _B_PX, mean)
            dx, dy, left, settled = _approach(tile_b, px - x0, py - y0, patch, s, inverse)
            px, py = dx + x0, dy + y0
            away = max(abs(px + _LEFT + 0.5 - guess_px[k, 0]), abs(py + _LEFT + 0.5 - guess_px[k, 1]))
            if not left or away > reach_px or not _within(px, py, b):
                break
        if settled:
            dx, dy, step, score, scatter = _settle(tile_b, px - x0, py - y0, patch, factor, rows, s, inverse)
            px, py = dx + x0, dy + y0
            told[k, 0], told[k, 1], told[k, 2] = score, scatter, step
            _soften(gx, padded, soft_rows, s)
            blurred[k, 0, 0], blurred[k, 0, 1] = _dot(gx, s), _dot(gy, s)
            _soften(gy, padded, soft_rows, s)
            blurred[k, 1, 0], blurred[k, 1, 1] = blurred[k, 0, 1], _dot(gy, s)
            _cut(b, round(px), round(py), raw, WINDOW_PX - 2 * BLUR_REACH)
            told[k, 3] = max(told[k, 3], _saturated(raw, 0))
        b_px[k, 0], b_px[k, 1] = px + _LEFT + 0.5, py + _LEFT + 0.5


@inlined
def _approach(
    tile: _Plane, dx: float, dy: float, patch: _Patch, s: _Plane, inverse: _Inverse
) -> tuple[float, float, bool, bool]:
    """Steps with bilinear interpolation: the place reached, whether it left the tile, whether it stands still."""
    tt, ixx, ixy, iyy = inverse
    for _ in range(_MOST_STEPS):
        if _outside(dx, dy):
            return dx, dy, True, False
        _bilinear(tile, dx, dy, s)
        _, st, sx, sy, _ = _products(s, patch)
        if st <= _LEAST_GAIN * tt:
            return dx, dy, False, False
        ex, ey = (ixx * sx + ixy * sy) * tt / st, (ixy * sx + iyy * sy) * tt / st
        length = max(abs(ex), abs(ey))
        share = min(1.0, _LONGEST_STEP_PX / max(length, 1e-9))
        dx, dy = dx - ex * share, dy - ey * share
        if length < _STILL_PX:
            return dx, dy, False, not _outside(dx, dy)
    return dx, dy, False, False


@inlined
def _settle(
    tile: _Plane, dx: float, dy: float, patch: _Patch, factor: Floats, rows: _Plane, s: _Plane, inverse: _Inverse
) -> tuple[float, float, float, float, float]:
    """Two steps with the sinc: place, length of the last step (infinite if lost), correlation and scatter after it."""
    tt, ixx, ixy, iyy = inverse
    step, score, scatter = np.inf, 0.0, 0.0
    for _ in range(2):
        if _outside(dx, dy):
            return dx, dy, np.inf, 0.0, 0.0
        _sharp(tile, dx, dy, rows, s)
        s1, st, sx, sy, ss = _products(s, patch)
        if st <= _LEAST_GAIN * tt:
            return dx, dy, np.inf, 0.0, 0.0
        gain = st / tt
        sx, sy = sx / gain, sy / gain
        ex, ey = ixx * sx + ixy * sy, ixy * sx + iyy * sy
        dx, dy, step = dx - ex, dy - ey, max(abs(ex), abs(ey))
        v0, v1, v2, v3 = _halfway(factor, s1, st, _dot(s, patch[3]), _dot(s, patch[4]))
        left = (ss - v0 * v0 - v1 * v1 - v2 * v2 - v3 * v3) / (gain * gain) - (ex * sx + ey * sy)
        left = max(left, 0.0)
        score, scatter = math.sqrt(tt / (tt + left)), math.sqrt(left / _AREA)
    return dx, dy, step, score, scatter


@inlined
def _outside(dx: float, dy: float) -> bool:
    """Whether a window needs more than its tile has."""
    low, high = TAPS // 2 - 1, _B_PX - WINDOW_PX - TAPS // 2
    return not (low <= dx < high and low <= dy < high)


@inlined
def _within(px: float, py: float, image: _Pixels) -> bool:
    """Whether a window whose first pixel is here keeps its margin to the image's border."""
    h, w = image.shape
    low = MARGIN_PX - _LEFT - 0.5
    return bool(low <= px <= w - MARGIN_PX - _LEFT and low <= py <= h - MARGIN_PX - _LEFT)


@inlined
def _cut(image: _Pixels, x0: int, y0: int, raw: _Pixels, size: int) -> None:
    """A square of an image, with room for the blur around `size`; beyond the border its last pixels are repeated."""
    h, w = image.shape
    side = size + 2 * BLUR_REACH
    inside = 0 <= x0 <= w - side
    for y in range(side):
        line, to = image[min(max(y0 + y, 0), h - 1)], raw[y]
        if inside:
            cut = line[x0 : x0 + side]
            for x in range(side):
                to[x] = cut[x]
        else:
            for x in range(side):
                to[x] = line[min(max(x0 + x, 0), w - 1)]


@inlined
def _blur(raw: _Pixels, half_way: _Plane, out: _Plane, size: int, less: float) -> None:
    """Gaussian across and down, less a constant; `raw` has room for its reach on every side."""
    w0, w1, w2, w3, w4 = GAUSS[0], GAUSS[1], GAUSS[2], GAUSS[3], GAUSS[4]
    for y in range(size + 2 * BLUR_REACH):
        line, to = raw[y], half_way[y]
        for x in range(size):
            near = w1 * (_Float(line[x + 3]) + _Float(line[x + 5])) + w2 * (_Float(line[x + 2]) + _Float(line[x + 6]))
            far = w3 * (_Float(line[x + 1]) + _Float(line[x + 7])) + w4 * (_Float(line[x]) + _Float(line[x + 8]))
            to[x] = w0 * _Float(line[x + 4]) + near + far
    _down(half_way, out, size, (w0, w1, w2, w3, w4), _Float(less))


@inlined
def _down(lines: _Plane, out: _Plane, size: int, w: tuple[np.float32, ...], less: np.float32) -> None:
    """Nine points of every column, symmetrically weighted from the middle outwards, less a constant."""
    w0, w1, w2, w3, w4 = w
    for y in range(size):
        a, b, c, d, e = lines[y], lines[y + 1], lines[y + 2], lines[y + 3], lines[y + 4]
        f, g, h, i = lines[y + 5], lines[y + 6], lines[y + 7], lines[y + 8]
        to = out[y]
        for x in range(size):
            to[x] = w0 * e[x] + w1 * (d[x] + f[x]) + w2 * (c[x] + g[x]) + w3 * (b[x] + h[x]) + w4 * (a[x] + i[x]) - less


@inlined
def _saturated(raw: _Pixels, border: int) -> float:
    """Share of a window's pixels that are blown out."""
    count = 0
    for y in range(WINDOW_PX):
        line = raw[y + border]
        for x in range(WINDOW_PX):
            count += line[x + border] >= _SATURATED
    return count / _AREA


@inlined
def _template(tile: _Plane, patch: _Patch, factor: Floats) -> tuple[float, float, float, float, float]:
    """Make a patch and the factor of its light; returns its mean, t·t and the sums of products of its slopes."""
    t, gx, gy, tx, ty = patch
    half, total = _Float(0.5), _Float(0)
    for y in range(WINDOW_PX):
        above, line, below = tile[y], tile[y + 1], tile[y + 2]
        first = y * WINDOW_PX
        to_t, to_x, to_y = t[first : first + WINDOW_PX], gx[first : first + WINDOW_PX], gy[first : first + WINDOW_PX]
        for x in range(WINDOW_PX):
            to_t[x] = line[x + 1]
            to_x[x] = half * (line[x + 2] - line[x])
            to_y[x] = half * (below[x + 1] - above[x + 1])
            total += line[x + 1]
    mean = total / _Float(_AREA)
    for n in range(_AREA):
        tx[n], ty[n] = t[n] * ACROSS[n], t[n] * DOWN[n]
        t[n] -= mean
    s02 = s03 = s11 = s12 = s13 = s22 = s23 = s33 = _Float(0)
    x0 = x1 = x2 = x3 = y0 = y1 = y2 = y3 = _Float(0)
    for n in range(_AREA):
        a, b, c, u, v = t[n], tx[n], ty[n], gx[n], gy[n]
        s02 += b
        s03 += c
        s11 += a * a
        s12 += a * b
        s13 += a * c
        s22 += b * b
        s23 += b * c
        s33 += c * c
        x0 += u
        x1 += u * a
        x2 += u * b
        x3 += u * c
        y0 += v
        y1 += v * a
        y2 += v * b
        y3 += v * c
    factor[0, 0], factor[1, 0], factor[2, 0], factor[3, 0] = _AREA, 0.0, s02, s03
    factor[1, 1], factor[2, 1], factor[3, 1] = s11, s12, s13
    factor[2, 2], factor[3, 2], factor[3, 3] = s22, s23, s33
    _factorise(factor)
    p0, p1, p2, p3 = _solved(factor, float(x0), float(x1), float(x2), float(x3))
    q0, q1, q2, q3 = _solved(factor, float(y0), float(y1), float(y2), float(y3))
    xx = xy = yy = _Float(0)
    for n in range(_AREA):
        u = gx[n] - (_Float(p0) + _Float(p1) * t[n] + _Float(p2) * tx[n] + _Float(p3) * ty[n])
        v = gy[n] - (_Float(q0) + _Float(q1) * t[n] + _Float(q2) * tx[n] + _Float(q3) * ty[n])
        gx[n], gy[n] = u, v
        xx += u * u
        xy += u * v
        yy += v * v
    return float(mean), max(float(s11), 1e-6), float(xx), float(xy), float(yy)


@inlined
def _factorise(m: Floats) -> None:
    """Cholesky factor of a matrix (4, 4), in its lower triangle; a little is added where texture may be nil."""
    for i in range(4):
        m[i, i] += 1e-3 if i else 0.0
        for j in range(i + 1):
            value = m[i, j]
            for k in range(j):
                value -= m[i, k] * m[j, k]
            m[i, j] = math.sqrt(max(value, 1e-9)) if i == j else value / m[j, j]


@inlined
def _halfway(m: Floats, b0: float, b1: float, b2: float, b3: float) -> tuple[float, float, float, float]:
    """L⁻¹·b for the factor L."""
    v0 = b0 / m[0, 0]
    v1 = (b1 - m[1, 0] * v0) / m[1, 1]
    v2 = (b2 - m[2, 0] * v0 - m[2, 1] * v1) / m[2, 2]
    return v0, v1, v2, (b3 - m[3, 0] * v0 - m[3, 1] * v1 - m[3, 2] * v2) / m[3, 3]


@inlined
def _solved(m: Floats, b0: float, b1: float, b2: float, b3: float) -> tuple[float, float, float, float]:
    """(L·Lᵀ)⁻¹·b for the factor L."""
    v0, v1, v2, v3 = _halfway(m, b0, b1, b2, b3)
    w3 = v3 / m[3, 3]
    w2 = (v2 - m[3, 2] * w3) / m[2, 2]
    w1 = (v1 - m[2, 1] * w2 - m[3, 1] * w3) / m[1, 1]
    return (v0 - m[1, 0] * w1 - m[2, 0] * w2 - m[3, 0] * w3) / m[0, 0], w1, w2, w3


@inlined
def _dot(a: _Plane, b: _Plane) -> float:
    total = _Float(0)
    for n in range(_AREA):
        total += a[n] * b[n]
    return float(total)


@inlined
def _soften(g: _Plane, padded: _Plane, lines: _Plane, out: _Plane) -> None:
    """A slope blurred twice, as far as the window goes; nothing lies beyond it."""
    w0, w1, w2, w3, w4 = TWICE[0], TWICE[1], TWICE[2], TWICE[3], TWICE[4]
    v = padded
    for y in range(WINDOW_PX):
        to = lines[y + BLUR_REACH]
        v[BLUR_REACH : BLUR_REACH + WINDOW_PX] = g[y * WINDOW_PX : (y + 1) * WINDOW_PX]
        for x in range(WINDOW_PX):
            near = w1 * (v[x + 3] + v[x + 5]) + w2 * (v[x + 2] + v[x + 6])
            to[x] = w0 * v[x + 4] + near + w3 * (v[x + 1] + v[x + 7]) + w4 * (v[x] + v[x + 8])
    _down(lines, out.reshape(WINDOW_PX, WINDOW_PX), WINDOW_PX, (w0, w1, w2, w3, w4), _Float(0))


@inlined
def _products(s: _Plane, patch: _Patch) -> tuple[float, float, float, float, float]:
    """Sums of s, s·t, s·gx, s·gy, s·s."""
    t, gx, gy = patch[0], patch[1], patch[2]
    s1 = st = sx = sy = ss = _Float(0)
    for n in range(_AREA):
        v = s[n]
        s1 += v
        st += v * t[n]
        sx += v * gx[n]
        sy += v * gy[n]
        ss += v * v
    return float(s1), float(st), float(sx), float(sy), float(ss)


@inlined
def _bilinear(tile: _Plane, x: float, y: float, out: _Plane) -> None:
    """The window whose first pixel lies at (x, y) of a tile."""
    x0, y0, one = int(x), int(y), _Float(1)
    fx, fy = _Float(x - x0), _Float(y - y0)
    w00, w01, w10, w11 = (one - fx) * (one - fy), fx * (one - fy), (one - fx) * fy, fx * fy
    for r in range(WINDOW_PX):
        upper = tile[y0 + r, x0 : x0 + WINDOW_PX + 1]
        lower = tile[y0 + r + 1, x0 : x0 + WINDOW_PX + 1]
        to = out[r * WINDOW_PX : (r + 1) * WINDOW_PX]
        for c in range(WINDOW_PX):
            to[c] = w00 * upper[c] + w01 * upper[c + 1] + w10 * lower[c] + w11 * lower[c + 1]


@inlined
def _sharp(tile: _Plane, x: float, y: float, rows: _Plane, out: _Plane) -> None:
    """The same by the sinc of six points."""
    x0, y0 = int(x), int(y)
    w0, w1, w2, w3, w4, w5 = _weights(x - x0)
    for r in range(WINDOW_PX + TAPS - 1):
        a, to = tile[y0 - 2 + r, x0 - 2 : x0 + WINDOW_PX + 3], rows[r]
        for n in range(WINDOW_PX):
            to[n] = w0 * a[n] + w1 * a[n + 1] + w2 * a[n + 2] + w3 * a[n + 3] + w4 * a[n + 4] + w5 * a[n + 5]
    w0, w1, w2, w3, w4, w5 = _weights(y - y0)
    for r in range(WINDOW_PX):
        a, b, c, d, e, f = rows[r], rows[r + 1], rows[r + 2], rows[r + 3], rows[r + 4], rows[r + 5]
        to = out[r * WINDOW_PX : (r + 1) * WINDOW_PX]
        for n in range(WINDOW_PX):
            to[n] = w0 * a[n] + w1 * b[n] + w2 * c[n] + w3 * d[n] + w4 * e[n] + w5 * f[n]


@inlined
def _weights(f: float) -> tuple[float, float, float, float, float, float]:
    """Of the six points at a fraction, between the two nearest of the table."""
    at = f * FRACTIONS
    n = min(int(at), FRACTIONS - 1)
    w = SINC[n] + _Float(at - n) * (SINC[n + 1] - SINC[n])
    return w[0], w[1], w[2], w[3], w[4], w[5]
