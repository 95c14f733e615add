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

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats

WINDOW_PX = 24
"""Side of the patch that is compared: three vector registers of eight."""
BLUR_PX = 1.2
_BLUR_REACH = 4
_TAPS, _KAISER, _FRACTIONS = 6, 6.0, 512
ROOM_PX = 3
"""How far a patch may move within the tile that is cut out of b; beyond that a new tile is cut …"""
_MOST_TILES = 5
"""… so many times."""
MARGIN_PX = WINDOW_PX // 2 + _TAPS // 2
"""A patch's middle keeps so far off the border of either image; what the blur wants beyond that is repeated."""
_MOST_STEPS, _STILL_PX, _LONGEST_STEP_PX = 12, 0.02, 1.5
_LEAST_GAIN = 1e-3
_LEAST_CORNER = 1e-6
"""det H / (trace H)² below which a patch is but an edge."""
_SATURATED = 254

_A_PX = WINDOW_PX + 2
_B_PX = WINDOW_PX + 2 * ROOM_PX + _TAPS
_B_FIRST = ROOM_PX + _TAPS // 2
"""Where in a tile of b the window's first pixel lies when it is cut."""
_SOFT_PX = WINDOW_PX + 2 * _BLUR_REACH
_LEFT = WINDOW_PX // 2 - 1
_AREA = WINDOW_PX * WINDOW_PX

_Pixels = NDArray[np.uint8]
_Plane = NDArray[np.float32]
_Float = np.float32


def _gauss() -> _Plane:
    """Weights (5,) of the blur, from the middle outwards."""
    weights = np.exp(-0.5 * (np.arange(_BLUR_REACH + 1) / BLUR_PX) ** 2)
    return np.asarray(weights / (2 * weights.sum() - weights[0]), dtype=np.float32)


def _sinc() -> _Plane:
    """Weights (steps + 1, 6) at fractions 0 … 1: they move blurred texture to 0.002 px."""
    f = np.linspace(0, 1, _FRACTIONS + 1)
    at = np.arange(1 - _TAPS // 2, _TAPS // 2 + 1) - f[:, None]
    window = np.i0(_KAISER * np.sqrt(np.maximum(1 - (at / (_TAPS / 2)) ** 2, 0)))
    weights = np.sinc(at) * window
    return np.asarray(weights / weights.sum(1, keepdims=True), dtype=np.float32)


_GAUSS = _gauss()
_SINC = _sinc()


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
        blurred: out, (k, 2, 2) the same of slopes blurred once more: what blurred noise makes of them.
        told: out, (k, 4) correlation, scatter of what is left (grey levels), last step (px; infinite if lost), share of
            saturated pixels.
    """
    raw = np.empty((_B_PX + 2 * _BLUR_REACH, _B_PX + 2 * _BLUR_REACH), np.uint8)
    half_way = np.empty((_B_PX + 2 * _BLUR_REACH, _B_PX), _Float)
    tile_a, tile_b = np.empty((_A_PX, _A_PX), _Float), np.empty((_B_PX, _B_PX), _Float)
    t, gx, gy, s = np.empty(_AREA, _Float), np.empty(_AREA, _Float), np.empty(_AREA, _Float), np.empty(_AREA, _Float)
    light = np.empty((2, _AREA), _Float)
    padded = np.zeros((_SOFT_PX + 2 * _BLUR_REACH, _SOFT_PX + 2 * _BLUR_REACH), _Float)
    soft = np.empty((2, _SOFT_PX, _SOFT_PX), _Float)
    rows = np.empty((WINDOW_PX + _TAPS - 1, WINDOW_PX), _Float)
    for k in range(len(places)):
        _cut(a, places[k, 0] - _LEFT - 1 - _BLUR_REACH, places[k, 1] - _LEFT - 1 - _BLUR_REACH, raw, _A_PX)
        _blur(raw, half_way, tile_a, _A_PX)
        told[k, 2], told[k, 3] = np.inf, _saturated(raw, _BLUR_REACH + 1)
        tt, xx, xy, yy = _template(tile_a, t, gx, gy, light)
        hessian[k, 0, 0], hessian[k, 0, 1], hessian[k, 1, 0], hessian[k, 1, 1] = xx, xy, xy, yy
        determinant = xx * yy - xy * xy
        if determinant <= _LEAST_CORNER * (xx + yy) ** 2 + _LEAST_CORNER:
            b_px[k] = guess_px[k]
            continue
        ixx, ixy, iyy = yy / determinant, -xy / determinant, xx / determinant
        px, py = guess_px[k, 0] - _LEFT - 0.5, guess_px[k, 1] - _LEFT - 0.5  # of the window's first pixel from here on
        x0, y0, settled = 0, 0, False
        for _ in range(_MOST_TILES):
            x0, y0 = math.floor(px) - _B_FIRST, math.floor(py) - _B_FIRST
            _cut(b, x0 - _BLUR_REACH, y0 - _BLUR_REACH, raw, _B_PX)
            _blur(raw, half_way, tile_b, _B_PX)
            dx, dy, left, settled = _approach(tile_b, px - x0, py - y0, t, gx, gy, s, tt, ixx, ixy, iyy)
            px, py = dx + x0, dy + y0
            away = max(abs(px + _LEFT + 0.5 - guess_px[k, 0]), abs(py + _LEFT + 0.5 - guess_px[k, 1]))
            if not left or away > reach_px or not _within(px, py, b):
                break
        if settled:
            dx, dy, step, score, scatter = _settle(
                tile_b, px - x0, py - y0, t, gx, gy, light, rows, s, tt, ixx, ixy, iyy
            )
            px, py = dx + x0, dy + y0
            told[k, 0], told[k, 1], told[k, 2] = score, scatter, step
            _soften(gx, padded, half_way, soft[0])
            _soften(gy, padded, half_way, soft[1])
            blurred[k, 0, 0] = _dot(soft[0].ravel(), soft[0].ravel())
            blurred[k, 1, 1] = _dot(soft[1].ravel(), soft[1].ravel())
            blurred[k, 0, 1] = blurred[k, 1, 0] = _dot(soft[0].ravel(), soft[1].ravel())
            _cut(b, round(px), round(py), raw, WINDOW_PX - 2 * _BLUR_REACH)
            told[k, 3] = max(told[k, 3], _saturated(raw, 0))
        b_px[k, 0], b_px[k, 1] = px + _LEFT + 0.5, py + _LEFT + 0.5


@compiled
def _approach(
    tile: _Plane,
    dx: float,
    dy: float,
    t: _Plane,
    gx: _Plane,
    gy: _Plane,
    s: _Plane,
    tt: float,
    ixx: float,
    ixy: float,
    iyy: float,
) -> tuple[float, float, bool, bool]:
    """Steps with bilinear interpolation: the place reached, whether it left the tile, whether it stands still."""
    for _ in range(_MOST_STEPS):
        if _outside(dx, dy):
            return dx, dy, True, False
        _bilinear(tile, dx, dy, s)
        _, st, sx, sy, _ = _products(s, t, gx, gy)
        if st <= _LEAST_GAIN * tt:
            return dx, dy, False, False
        ex, ey = (ixx * sx + ixy * sy) * tt / st, (ixy * sx + iyy * sy) * tt / st
        length = max(abs(ex), abs(ey))
        share = min(1.0, _LONGEST_STEP_PX / max(length, 1e-9))
        dx, dy = dx - ex * share, dy - ey * share
        if length < _STILL_PX:
            return dx, dy, False, not _outside(dx, dy)
    return dx, dy, False, False


@compiled
def _settle(
    tile: _Plane,
    dx: float,
    dy: float,
    t: _Plane,
    gx: _Plane,
    gy: _Plane,
    light: _Plane,
    rows: _Plane,
    s: _Plane,
    tt: float,
    ixx: float,
    ixy: float,
    iyy: float,
) -> tuple[float, float, float, float, float]:
    """Two steps with the sinc: place, length of the last step (infinite if lost), correlation and scatter after it."""
    step, score, scatter = np.inf, 0.0, 0.0
    for _ in range(2):
        if _outside(dx, dy):
            return dx, dy, np.inf, 0.0, 0.0
        _sharp(tile, dx, dy, rows, s)
        s1, st, sx, sy, ss = _products(s, t, gx, gy)
        if st <= _LEAST_GAIN * tt:
            return dx, dy, np.inf, 0.0, 0.0
        gain = st / tt
        sx, sy = sx / gain, sy / gain
        ex, ey = ixx * sx + ixy * sy, ixy * sx + iyy * sy
        dx, dy, step = dx - ex, dy - ey, max(abs(ex), abs(ey))
        lit = _dot(s, light[0]) ** 2 + _dot(s, light[1]) ** 2
        left = max((ss - s1 * s1 / _AREA - lit) / (gain * gain) - tt - (ex * sx + ey * sy), 0.0)
        score, scatter = math.sqrt(tt / (tt + left)), math.sqrt(left / _AREA)
    return dx, dy, step, score, scatter


@compiled
def _outside(dx: float, dy: float) -> bool:
    """Whether a window needs more than its tile has."""
    low, high = _TAPS // 2 - 1, _B_PX - WINDOW_PX - _TAPS // 2
    return not (low <= dx < high and low <= dy < high)


@compiled
def _within(px: float, py: float, image: _Pixels) -> bool:
    """Whether a window whose first pixel is here keeps its margin to the image's border."""
    h, w = image.shape
    low = MARGIN_PX - _LEFT - 0.5
    return bool(low <= px <= w - MARGIN_PX - _LEFT and low <= py <= h - MARGIN_PX - _LEFT)


@compiled
def _cut(image: _Pixels, x0: int, y0: int, raw: _Pixels, size: int) -> None:
    """A square of an image, with room for the blur around `size`; beyond the border its last pixels are repeated."""
    h, w = image.shape
    side = size + 2 * _BLUR_REACH
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


@compiled
def _blur(raw: NDArray[np.generic], half_way: _Plane, out: _Plane, size: int) -> None:
    """Gaussian of nine points across and down; `raw` is larger than `out` by its reach on every side."""
    w0, w1, w2, w3, w4 = _GAUSS[0], _GAUSS[1], _GAUSS[2], _GAUSS[3], _GAUSS[4]
    for y in range(size + 2 * _BLUR_REACH):
        line, to = raw[y], half_way[y]
        for x in range(size):
            to[x] = (
                w0 * _Float(line[x + 4])
                + w1 * (_Float(line[x + 3]) + _Float(line[x + 5]))
                + w2 * (_Float(line[x + 2]) + _Float(line[x + 6]))
                + w3 * (_Float(line[x + 1]) + _Float(line[x + 7]))
                + w4 * (_Float(line[x]) + _Float(line[x + 8]))
            )
    for y in range(size):
        to = out[y]
        l0, l1, l2, l3, l4 = half_way[y], half_way[y + 1], half_way[y + 2], half_way[y + 3], half_way[y + 4]
        l5, l6, l7, l8 = half_way[y + 5], half_way[y + 6], half_way[y + 7], half_way[y + 8]
        for x in range(size):
            to[x] = (
                w0 * l4[x] + w1 * (l3[x] + l5[x]) + w2 * (l2[x] + l6[x]) + w3 * (l1[x] + l7[x]) + w4 * (l0[x] + l8[x])
            )


@compiled
def _saturated(raw: _Pixels, border: int) -> float:
    """Share of a window's pixels that are blown out."""
    count = 0
    for y in range(WINDOW_PX):
        line = raw[y + border]
        for x in range(WINDOW_PX):
            count += line[x + border] >= _SATURATED
    return count / _AREA


@compiled
def _template(tile: _Plane, t: _Plane, gx: _Plane, gy: _Plane, light: _Plane) -> tuple[float, float, float, float]:
    """Patch, slopes free of light, and t·x, t·y made orthonormal; returns t·t and the products of the slopes."""
    half, middle = _Float(0.5), _Float((WINDOW_PX - 1) / 2)
    for y in range(WINDOW_PX):
        above, line, below = tile[y], tile[y + 1], tile[y + 2]
        first = y * WINDOW_PX
        to_t, to_x, to_y = t[first : first + WINDOW_PX], gx[first : first + WINDOW_PX], gy[first : first + WINDOW_PX]
        for x in range(WINDOW_PX):
            to_t[x] = line[x + 1]
            to_x[x] = half * (line[x + 2] - line[x])
            to_y[x] = half * (below[x + 1] - above[x + 1])
    for y in range(WINDOW_PX):
        down = _Float(y) - middle
        for x in range(WINDOW_PX):
            light[0, y * WINDOW_PX + x] = t[y * WINDOW_PX + x] * (_Float(x) - middle)
            light[1, y * WINDOW_PX + x] = t[y * WINDOW_PX + x] * down
    for v in (t, light[0], light[1], gx, gy):
        _center(v)
    tt = max(_dot(t, t), 1e-6)
    for v in (light[0], light[1], gx, gy):
        _free(v, t, tt)
    _normalise(light[0], tt)
    for v in (light[1], gx, gy):
        _free(v, light[0], 1.0)
    _normalise(light[1], tt)
    for v in (gx, gy):
        _free(v, light[1], 1.0)
    return tt, _dot(gx, gx), _dot(gx, gy), _dot(gy, gy)


@compiled
def _center(v: _Plane) -> None:
    """Take the mean away."""
    total = _Float(0)
    for n in range(_AREA):
        total += v[n]
    total /= _Float(_AREA)
    for n in range(_AREA):
        v[n] -= total


@compiled
def _dot(a: _Plane, b: _Plane) -> float:
    total = _Float(0)
    for n in range(len(a)):
        total += a[n] * b[n]
    return float(total)


@compiled
def _free(v: _Plane, of: _Plane, square: float) -> None:
    """Take away the share of one vector, of known square, from another."""
    share = _Float(_dot(v, of) / square)
    for n in range(_AREA):
        v[n] -= share * of[n]


@compiled
def _normalise(v: _Plane, like: float) -> None:
    """To unit length; what is left of a vector that others explain is rounding, and becomes nothing."""
    square = _dot(v, v)
    factor = _Float(1 / math.sqrt(square)) if square > 1e-5 * like else _Float(0)
    for n in range(_AREA):
        v[n] *= factor


@compiled
def _soften(g: _Plane, padded: _Plane, half_way: _Plane, out: _Plane) -> None:
    """The blur of a slope, with what runs over the window's border."""
    for y in range(WINDOW_PX):
        to = padded[y + 2 * _BLUR_REACH]
        for x in range(WINDOW_PX):
            to[x + 2 * _BLUR_REACH] = g[y * WINDOW_PX + x]
    _blur(padded, half_way, out, _SOFT_PX)


@compiled
def _products(s: _Plane, t: _Plane, gx: _Plane, gy: _Plane) -> tuple[float, float, float, float, float]:
    """Sums of s, s·t, s·gx, s·gy, s·s."""
    s1 = st = sx = sy = ss = _Float(0)
    for n in range(_AREA):
        v = s[n]
        s1 += v
        st += v * t[n]
        sx += v * gx[n]
        sy += v * gy[n]
        ss += v * v
    return float(s1), float(st), float(sx), float(sy), float(ss)


@compiled
def _bilinear(tile: _Plane, x: float, y: float, out: _Plane) -> None:
    """The window whose first pixel lies at (x, y) of a tile."""
    x0, y0 = int(x), int(y)
    fx, fy, one = _Float(x - x0), _Float(y - y0), _Float(1)
    w00, w01, w10, w11 = (one - fx) * (one - fy), fx * (one - fy), (one - fx) * fy, fx * fy
    for r in range(WINDOW_PX):
        upper = tile[y0 + r, x0 : x0 + WINDOW_PX + 1]
        lower = tile[y0 + r + 1, x0 : x0 + WINDOW_PX + 1]
        to = out[r * WINDOW_PX : (r + 1) * WINDOW_PX]
        for c in range(WINDOW_PX):
            to[c] = w00 * upper[c] + w01 * upper[c + 1] + w10 * lower[c] + w11 * lower[c + 1]


@compiled
def _sharp(tile: _Plane, x: float, y: float, rows: _Plane, out: _Plane) -> None:
    """The same by the sinc of six points."""
    x0, y0 = int(x), int(y)
    a0, a1, a2, a3, a4, a5 = _weights(x - x0)
    for r in range(WINDOW_PX + _TAPS - 1):
        line, to = tile[y0 - 2 + r, x0 - 2 : x0 + WINDOW_PX + 3], rows[r]
        for c in range(WINDOW_PX):
            to[c] = (
                a0 * line[c]
                + a1 * line[c + 1]
                + a2 * line[c + 2]
                + a3 * line[c + 3]
                + a4 * line[c + 4]
                + a5 * line[c + 5]
            )
    a0, a1, a2, a3, a4, a5 = _weights(y - y0)
    for r in range(WINDOW_PX):
        to = out[r * WINDOW_PX : (r + 1) * WINDOW_PX]
        l0, l1, l2, l3, l4, l5 = rows[r], rows[r + 1], rows[r + 2], rows[r + 3], rows[r + 4], rows[r + 5]
        for c in range(WINDOW_PX):
            to[c] = a0 * l0[c] + a1 * l1[c] + a2 * l2[c] + a3 * l3[c] + a4 * l4[c] + a5 * l5[c]


@compiled
def _weights(f: float) -> tuple[float, float, float, float, float, float]:
    """Of the six points at a fraction, between the two nearest of the table."""
    at = f * _FRACTIONS
    n = min(int(at), _FRACTIONS - 1)
    u, v = _SINC[n], _SINC[n + 1]
    p = _Float(at - n)
    q = _Float(1) - p
    return (
        q * u[0] + p * v[0],
        q * u[1] + p * v[1],
        q * u[2] + p * v[2],
        q * u[3] + p * v[3],
        q * u[4] + p * v[4],
        q * u[5] + p * v[5],
    )
