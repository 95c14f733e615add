"""The inner loop of matching: find a patch of image a in image b to a few thousandths of a pixel.

Both images are blurred around the patch. This removes most of the interpolation's bias towards whole pixels. The
position is then found by inverse-compositional Gauss-Newton steps, with gain and offset. The first steps use bilinear
interpolation. Once steps are short, they use a sinc of six points with a Kaiser window, until they converge.

Let t be the patch of image a minus its mean, and s the window of image b at the current position. Let g be the slopes
of the patch in x and y, made orthogonal to changes of light (see below), and H = g·gᵀ. Products are sums over all
pixels. One step moves the window by H⁻¹·(g·s) / gain, where gain = (t·s) / (t·t).

**Light.** Vignetting, and light that falls off to one side, make a patch brighter on one side. In image b this is often
the opposite side. A round mark of 5 px then seems to move by 0.01 to 0.02 px. The error is the same in all patches and
does not average out. Therefore the slopes are made orthogonal to four changes of light: an offset, a gain, and a gain
that varies linearly in x or in y. The corresponding vectors are 1, t, t·x and t·y. For the last two, the code uses the
blurred pixels in place of t.

**Memory.** Patches and tiles are flat arrays whose lines begin `PITCH_PX` apart, so that one loop runs over all lines.
The compiler turns this loop into vector instructions, which it would not do for a loop over one line of 24 pixels. In
every sum of products, at least one factor is 0 in the padding of the lines.

A tile is a blurred square of an image, from which patches and windows are taken. It is computed from a square of raw
pixels, which is larger by `BLUR_REACH` on every side and may have a larger pitch.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined, prefetch
from vaoi_station.geometry.transforms import Floats

WINDOW_PX = 24  # side of a patch: three vector registers of eight pixels
PITCH_PX = 32
"""Distance between the starts of two lines of a patch or tile in memory, in pixels.

The rest of each line is filled with 0, so that one loop can run over all lines at once."""
BINOMIAL = (20, 15, 6, 1)
"""Weights of the blur, in 64ths, from the centre outwards.

They are whole numbers, they are close to a Gaussian with σ = 1.22 px, and they remove the Nyquist frequency
completely."""
BLUR_REACH = 3  # number of pixels on each side of a pixel that the blur reads
TAPS = 6  # number of neighbouring pixels from which the sinc interpolates a value in one direction
FRACTIONS = 512
"""Number of fractions of a pixel for which `SINC` contains weights; weights in between are interpolated linearly."""
KERNEL_REACH, KERNEL_STEPS = 3, 512
"""Reach in pixels of the sinc with which frames are resampled, and number of distances per pixel in `KERNEL`."""
_KAISER = 6.0  # shape parameter of the Kaiser window, which limits the sinc to `TAPS` pixels

_Table = NDArray[np.float32]


def _sinc() -> _Table:
    """Return the weights (FRACTIONS + 1, TAPS) of a windowed sinc. Each sum to 1, which keeps the mean grey level."""
    f = np.linspace(0, 1, FRACTIONS + 1)
    at = np.arange(1 - TAPS // 2, TAPS // 2 + 1) - f[:, None]
    window = np.i0(_KAISER * np.sqrt(np.maximum(1 - (at / (TAPS / 2)) ** 2, 0)))
    weights = np.sinc(at) * window
    return np.asarray(weights / weights.sum(1, keepdims=True), dtype=np.float32)


def _kernel() -> _Table:
    """Return the weights of a windowed sinc at the distances 0 … KERNEL_REACH, `KERNEL_STEPS` per pixel."""
    at = np.arange(KERNEL_REACH * KERNEL_STEPS + 2) / KERNEL_STEPS
    window = np.i0(_KAISER * np.sqrt(np.maximum(1 - (at / KERNEL_REACH) ** 2, 0))) / np.i0(_KAISER)
    return np.asarray(np.sinc(at) * window, dtype=np.float32)


def _in_lines(values: NDArray[np.float64]) -> _Table:
    """Return the values of a patch (WINDOW_PX, WINDOW_PX) as a flat array, each line padded with 0 to PITCH_PX."""
    lines = np.zeros((WINDOW_PX, PITCH_PX), dtype=np.float32)
    lines[:, :WINDOW_PX] = values
    return lines.ravel()


NOISE_SHARE = float((924 / 64**2) ** 2)
"""Share of the variance of white noise that remains after the blur. The squared weights of the blur sum to
C(12, 6) / 64² = 924 / 64² in x, and the same in y."""
SINC = _sinc()
"""(FRACTIONS + 1, TAPS) weights of the sinc interpolation at the fractions 0 … 1 of a pixel. The error of the
interpolation displaces blurred texture by 0.002 px."""
KERNEL = _kernel()  # (1538,) weights of the sinc, by distance from a pixel
INSIDE = _in_lines(np.ones((WINDOW_PX, WINDOW_PX)))
"""(768,) 1 at the pixels of a patch and 0 in the padding of its lines."""
ACROSS, DOWN = map(_in_lines, np.meshgrid(np.linspace(-1, 1, WINDOW_PX), np.linspace(-1, 1, WINDOW_PX)))
"""(768,) the coordinates x and y of each pixel of a patch, from −1 to 1; 0 in the padding of its lines."""


Pixels = NDArray[np.uint8]
Plane = NDArray[np.float32]

_SATURATED = 254  # grey level from which a pixel counts as saturated
_F32 = np.float32


@inlined
def fetch(image: Pixels, x0: int, y0: int, lines: int) -> None:
    """Let the processor read the pixels from (x0, y0) on that a tile will need: a quarter of the time was waiting."""
    h, w = image.shape
    first = image.ctypes.data + min(max(y0, 0), h - lines) * w + min(max(x0, 0), w - 1)
    for k in range(lines):
        prefetch(first + k * w)
        prefetch(first + k * w + _B_PITCH)


@inlined
def cut(image: Pixels, x0: int, y0: int, raw: Pixels, size: int, pitch: int, wide: int) -> None:
    """Copy the raw pixels for a tile of side `size`, from (x0, y0) of an image on; outside it, its border is repeated.

    `wide` equals `pitch`, but is not a constant for the compiler, which would unroll a copy of constant length byte by
    byte.
    """
    h, w = image.shape
    side = size + 2 * BLUR_REACH
    if 0 <= x0 <= w - pitch and 0 <= y0 <= h - side:
        for y in range(side):
            line, to = image[y0 + y, x0 : x0 + wide], raw[y * pitch : y * pitch + wide]
            for x in range(wide):
                to[x] = line[x]
    else:
        for y in range(side):
            line = image[min(max(y0 + y, 0), h - 1)]
            for x in range(side):
                raw[y * pitch + x] = line[min(max(x0 + x, 0), w - 1)]


@inlined
def blur(raw: Pixels, half_way: Plane, out: Plane, size: int, pitch: int, less: float) -> None:
    """Blur raw pixels to a tile `out` of side `size`, and subtract the constant `less`.

    The blur first runs down the columns, in exact whole numbers, and then along the lines.
    """
    w0, w1, w2, w3 = BINOMIAL
    p = pitch
    for n in range(size * p):
        near = w1 * (raw[n + 2 * p] + raw[n + 4 * p]) + w2 * (raw[n + p] + raw[n + 5 * p])
        half_way[n] = np.uint16(w0 * raw[n + 3 * p] + near + w3 * (raw[n] + raw[n + 6 * p]))
    # 4096 = 64²: the weights of both directions are in 64ths. The sum down the columns was exact; only these products
    # round.
    v0, v1, v2, v3 = _F32(w0 / 4096), _F32(w1 / 4096), _F32(w2 / 4096), _F32(w3 / 4096)
    constant = _F32(less)
    for y in range(size):
        v, to = half_way[y * p : y * p + PITCH_PX + 2 * BLUR_REACH], out[y * PITCH_PX : (y + 1) * PITCH_PX]
        for x in range(PITCH_PX):
            near = v1 * (v[x + 2] + v[x + 4]) + v2 * (v[x + 1] + v[x + 5])
            to[x] = v0 * v[x + 3] + near + v3 * (v[x] + v[x + 6]) - constant


@inlined
def saturated_share(raw: Pixels, size: int, pitch: int, x0: int, y0: int) -> float:
    """Return the share of saturated pixels in the window whose first pixel is (x0, y0) of the raw pixels of a tile."""
    # Most tiles have no saturated pixel. Their maximum, a vectorised loop, shows this without counting.
    brightest = np.uint8(0)
    for n in range((size + 2 * BLUR_REACH) * pitch):
        brightest = max(brightest, raw[n])
    if brightest < _SATURATED:
        return 0.0
    count = 0
    for y in range(y0, y0 + WINDOW_PX):
        for x in range(x0, x0 + WINDOW_PX):
            count += raw[y * pitch + x] >= _SATURATED
    return count / (WINDOW_PX * WINDOW_PX)


_MOST_TILES = 7
"""Largest number of tiles cut out of image b for one patch. Within each tile the window can move by 1.5 px."""
MARGIN_PX = WINDOW_PX // 2 + TAPS // 2
"""Smallest distance of a patch's centre from the border of either image.
The blur reads further out; beyond the border it repeats the border pixels."""
_MOST_STEPS, _NEAR_PX, _STILL_PX, _LONGEST_STEP_PX, _LEAST_GAIN = 12, 0.25, 0.01, 1.5, 1e-3
"""Limits of the iteration.
After a step below `_NEAR_PX` the sinc replaces bilinear interpolation. A step with the sinc below `_STILL_PX` is the
last one. Steps longer than `_LONGEST_STEP_PX` are shortened to it. A patch is lost if its gain is below
`_LEAST_GAIN`."""
_FOLLOWED, _FOLLOWED_SCORE = 4, 0.8
"""The search for a patch starts at its guess plus a mean correction, because neighbouring patches move alike.
The correction is the mean shift from the guess of about `_FOLLOWED` earlier patches with a score of at least
`_FOLLOWED_SCORE`."""
_LEAST_CORNER = 1e-6
"""Smallest det H / (trace H)² of a patch that is searched.
Below it, the patch shows only an edge, so that its position along the edge cannot be found."""
_A_PX, _B_PX, _B_PITCH = WINDOW_PX + 2, 32, 40
"""Sides of the tiles cut out of images a and b, and the pitch of the raw pixels of image b.
That pitch includes the margin of the blur."""
_B_FIRST = 4  # position in x and y of the window's first pixel in a tile that is newly cut out of image b
_RAW_LINES, _PADDING, _TILE = 40, 6 * PITCH_PX, 34 * PITCH_PX
"""Sizes of buffers. They exceed the data, because loops over whole lines read a little beyond the last line."""
_LEFT = WINDOW_PX // 2 - 1
_A_BEFORE, _B_BEFORE = _LEFT + 1 + BLUR_REACH, _LEFT + 1 + _B_FIRST + BLUR_REACH
"""Distances in x and y from a patch's centre to the first pixels that are read of images a and b, about."""
_AREA = WINDOW_PX * WINDOW_PX
_SIZE = WINDOW_PX * PITCH_PX

_Patch = tuple[Plane, Plane, Plane, Plane, Plane]
"""The arrays of one patch, (768,) each: grey levels t minus their mean, slopes in x and in y, t·x and t·y."""


class Refinement(NamedTuple):
    """k patches after the refinement: the position of each in image b, and measures of its quality."""

    b_px: Floats
    """(k, 2) centres of the patches in image b; for a patch with too little texture to be searched, its guess."""
    hessian: Floats
    """(k, 2, 2) the normal matrices H = g·gᵀ, grey levels² / px²; g are the slopes of a patch in x and y."""
    blurred: Floats
    """(k, 2, 2) Σ (B g)(B g)ᵀ, with B the blur: the covariance of g·n for blurred white noise n of unit variance."""
    score: Floats  # (k,) correlation of the matched patches; 0 for a lost patch
    scatter: Floats  # (k,) rms of the difference between the two matched patches, grey levels
    last_step_px: Floats  # (k,) larger component of the last step; infinite if the patch was lost
    saturated: Floats  # (k,) share of saturated pixels in the patch of image a or of image b, whichever is larger


@compiled
def refine(  # noqa: PLR0912, PLR0915  (one loop over patches whose parts are inlined)
    a: Pixels, b: Pixels, corners: NDArray[np.int64], guess_px: Floats, reach_px: float
) -> Refinement:
    """Find patches of image a in image b.

    Args:
        a: first image.
        b: second image.
        corners: (k, 2) whole pixels in image a. The centre of a patch is half a pixel to the right and below.
        guess_px: (k, 2) predicted centres in image b.
        reach_px: a patch that moves further than about this from its guess is lost.
    """
    count = len(corners)
    b_px, hessian, blurred = np.empty((count, 2)), np.empty((count, 2, 2)), np.zeros((count, 2, 2))
    score, scatter, last_step_px, saturated = np.zeros(count), np.zeros(count), np.zeros(count), np.zeros(count)
    raw, half_way = np.zeros(_RAW_LINES * _B_PITCH, np.uint8), np.zeros(_RAW_LINES * _B_PITCH, _F32)
    tile_a, tile_b = np.zeros(_TILE, _F32), np.zeros(_TILE, _F32)
    padded_x, padded_y = np.zeros(_SIZE + 2 * _PADDING, _F32), np.zeros(_SIZE + 2 * _PADDING, _F32)
    gx, gy = padded_x[_PADDING : _PADDING + _SIZE], padded_y[_PADDING : _PADDING + _SIZE]
    t, tx, ty = np.zeros(_SIZE, _F32), np.zeros(_SIZE, _F32), np.zeros(_SIZE, _F32)
    patch, factor, lines, soft = (t, gx, gy, tx, ty), np.zeros((4, 4)), np.zeros(_TILE, _F32), np.zeros(_TILE, _F32)
    lead_x, lead_y, followed = 0.0, 0.0, 0
    # `one` is always 1, but the compiler does not know it. Otherwise it would unroll copies of constant length byte by
    # byte.
    further, one = reach_px + _LONGEST_STEP_PX, corners.shape[1] // 2
    for k in range(len(corners)):
        x0, y0 = corners[k, 0] - _LEFT - 1, corners[k, 1] - _LEFT - 1
        cut(a, x0 - BLUR_REACH, y0 - BLUR_REACH, raw, _A_PX, PITCH_PX, PITCH_PX * one)
        # Meanwhile the processor reads what comes next: the place in image b, and the next patch.
        next_x, next_y = round(guess_px[k, 0] + lead_x) - _B_BEFORE, round(guess_px[k, 1] + lead_y) - _B_BEFORE
        fetch(b, next_x, next_y, _B_PX + 2 * BLUR_REACH)
        if k + 1 < count:
            fetch(a, corners[k + 1, 0] - _A_BEFORE, corners[k + 1, 1] - _A_BEFORE, _A_PX + 2 * BLUR_REACH)
        blur(raw, half_way, tile_a, _A_PX, PITCH_PX, 0.0)
        last_step_px[k], saturated[k] = np.inf, saturated_share(raw, _A_PX, PITCH_PX, BLUR_REACH + 1, BLUR_REACH + 1)
        # A patch with too little texture keeps its guess.
        b_px[k, 0], b_px[k, 1] = guess_px[k, 0], guess_px[k, 1]
        mean, tt, xx, xy, yy = _template(tile_a, patch, factor)
        hessian[k, 0, 0], hessian[k, 0, 1], hessian[k, 1, 0], hessian[k, 1, 1] = xx, xy, xy, yy
        determinant = xx * yy - xy * xy
        if determinant <= _LEAST_CORNER * (xx + yy) ** 2 + _LEAST_CORNER:
            continue
        ixx, ixy, iyy = yy / determinant, -xy / determinant, xx / determinant
        # From here on, a position is that of the window's first pixel, not of its centre.
        first_x, first_y = guess_px[k, 0] - _LEFT - 0.5, guess_px[k, 1] - _LEFT - 0.5
        px, py, tiles, near, lost = first_x + lead_x, first_y + lead_y, 0, False, True
        s1 = st = sx = sy = ss = su = sv = ex = ey = length = 0.0
        for _ in range(_MOST_STEPS):
            lost = True
            if tiles == 0 or _outside(px - x0, py - y0):
                if tiles == _MOST_TILES:
                    break
                x0, y0, tiles = round(px) - _B_FIRST, round(py) - _B_FIRST, tiles + 1
                cut(b, x0 - BLUR_REACH, y0 - BLUR_REACH, raw, _B_PX, _B_PITCH, _B_PITCH * one)
                blur(raw, half_way, tile_b, _B_PX, _B_PITCH, mean)
            if near:
                s1, st, sx, sy, ss, su, sv = _sharp(tile_b, px - x0, py - y0, patch, lines)
            else:
                st, sx, sy = _bilinear(tile_b, px - x0, py - y0, patch)
            # The window has no contrast, or an inverted one: the step would be divided by a gain near 0 or below 0.
            if st <= _LEAST_GAIN * tt:
                break
            ex, ey = (ixx * sx + ixy * sy) * tt / st, (ixy * sx + iyy * sy) * tt / st
            length = max(abs(ex), abs(ey))
            # Far from the solution, the linear approximation gives steps that are too long: they are shortened.
            share = min(1.0, _LONGEST_STEP_PX / max(length, 1e-9))
            px, py = px - ex * share, py - ey * share
            if max(abs(px - first_x), abs(py - first_y)) > further or not _within(px, py, b):
                break
            # a match counts only if its last step used the sinc
            lost = not near
            if near and length < _STILL_PX:
                break
            near = near or length < _NEAR_PX
        b_px[k, 0], b_px[k, 1] = px + _LEFT + 0.5, py + _LEFT + 0.5
        if not lost:
            score[k], scatter[k] = _agreement(factor, tt, (s1, st, sx, sy, ss, su, sv), ex, ey)
            last_step_px[k] = length
            # the share of saturated pixels of image b is that of the window at its final position
            here = saturated_share(raw, _B_PX, _B_PITCH, round(px) - x0 + BLUR_REACH, round(py) - y0 + BLUR_REACH)
            saturated[k] = max(saturated[k], here)
            xx, xy, yy = _softened(padded_x, padded_y, soft)
            blurred[k, 0, 0], blurred[k, 0, 1], blurred[k, 1, 0], blurred[k, 1, 1] = xx, xy, xy, yy
            if score[k] >= _FOLLOWED_SCORE:
                followed = min(followed + 1, _FOLLOWED)
                lead_x += (px - first_x - lead_x) / followed
                lead_y += (py - first_y - lead_y) / followed
    return Refinement(b_px, hessian, blurred, score, scatter, last_step_px, saturated)


@inlined
def _agreement(
    factor: Floats, tt: float, sums: tuple[float, float, float, float, float, float, float], ex: float, ey: float
) -> tuple[float, float]:
    """Return correlation and scatter of a patch after its last step (ex, ey); `sums` are its sums before this step."""
    s1, st, sx, sy, ss, su, sv = sums
    v0, v1, v2, v3 = _halfway(factor, s1, st, su, sv)
    gain = st / tt
    left = (ss - v0 * v0 - v1 * v1 - v2 * v2 - v3 * v3) / (gain * gain) - (ex * sx + ey * sy) / gain
    left = max(left, 0.0)
    return math.sqrt(tt / (tt + left)), math.sqrt(left / _AREA)


@inlined
def _outside(dx: float, dy: float) -> bool:
    """Whether a window whose first pixel is (dx, dy) of a tile extends beyond the tile, margin of the sinc included."""
    low, high = TAPS // 2 - 1, _B_PX - WINDOW_PX - TAPS // 2 + 1
    return not (low <= dx < high and low <= dy < high)


@inlined
def _within(px: float, py: float, image: Pixels) -> bool:
    """Whether a window with its first pixel at (px, py) keeps the distance `MARGIN_PX` from the border of the image."""
    h, w = image.shape
    low = MARGIN_PX - _LEFT - 0.5
    return bool(low <= px <= w - MARGIN_PX - _LEFT and low <= py <= h - MARGIN_PX - _LEFT)


@inlined
def _template(tile: Plane, patch: _Patch, factor: Floats) -> tuple[float, float, float, float, float]:
    """Write the arrays of a patch, and the Cholesky factor (4, 4) of the products of 1, t, t·x and t·y.

    `tile` has blurred pixels of image a. Return the mean of the patch, t·t, and the entries xx, xy, yy of H.
    """
    t, gx, gy, tx, ty = patch
    half, total, p = _F32(0.5), _F32(0), PITCH_PX
    for n in range(_SIZE):
        total += INSIDE[n] * tile[n + p + 1]
    mean = total / _F32(_AREA)
    s02 = s03 = s11 = s12 = s13 = s22 = s23 = s33 = _F32(0)
    x0 = x1 = x2 = x3 = y0 = y1 = y2 = y3 = _F32(0)
    for n in range(_SIZE):
        here, inside = tile[n + p + 1], INSIDE[n]
        a, b, c = inside * (here - mean), here * ACROSS[n], here * DOWN[n]
        u, v = inside * half * (tile[n + p + 2] - tile[n + p]), inside * half * (tile[n + 2 * p + 1] - tile[n + 1])
        t[n], tx[n], ty[n], gx[n], gy[n] = a, b, c, u, v
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
    u0, u1, u2, u3 = _F32(p0), _F32(p1), _F32(p2), _F32(p3)
    v0, v1, v2, v3 = _F32(q0), _F32(q1), _F32(q2), _F32(q3)
    xx = xy = yy = _F32(0)
    for n in range(_SIZE):
        u = gx[n] - (u0 * INSIDE[n] + u1 * t[n] + u2 * tx[n] + u3 * ty[n])
        v = gy[n] - (v0 * INSIDE[n] + v1 * t[n] + v2 * tx[n] + v3 * ty[n])
        gx[n], gy[n] = u, v
        xx += u * u
        xy += u * v
        yy += v * v
    return float(mean), max(float(s11), 1e-6), float(xx), float(xy), float(yy)


@inlined
def _factorise(m: Floats) -> None:
    """Replace the lower triangle of a matrix (4, 4) by its Cholesky factor, regular also without texture."""
    for i in range(4):
        m[i, i] += 1e-3 if i else 0.0
        for j in range(i + 1):
            value = m[i, j]
            for k in range(j):
                value -= m[i, k] * m[j, k]
            m[i, j] = math.sqrt(max(value, 1e-9)) if i == j else value / m[j, j]


@inlined
def _halfway(m: Floats, b0: float, b1: float, b2: float, b3: float) -> tuple[float, float, float, float]:
    """Return L⁻¹·b for a Cholesky factor L (4, 4) and a vector b of four numbers."""
    v0 = b0 / m[0, 0]
    v1 = (b1 - m[1, 0] * v0) / m[1, 1]
    v2 = (b2 - m[2, 0] * v0 - m[2, 1] * v1) / m[2, 2]
    return v0, v1, v2, (b3 - m[3, 0] * v0 - m[3, 1] * v1 - m[3, 2] * v2) / m[3, 3]


@inlined
def _solved(m: Floats, b0: float, b1: float, b2: float, b3: float) -> tuple[float, float, float, float]:
    """Return (L·Lᵀ)⁻¹·b for a Cholesky factor L (4, 4) and a vector b of four numbers."""
    v0, v1, v2, v3 = _halfway(m, b0, b1, b2, b3)
    w3 = v3 / m[3, 3]
    w2 = (v2 - m[3, 2] * w3) / m[2, 2]
    w1 = (v1 - m[2, 1] * w2 - m[3, 1] * w3) / m[1, 1]
    return (v0 - m[1, 0] * w1 - m[2, 0] * w2 - m[3, 0] * w3) / m[0, 0], w1, w2, w3


@inlined
def _softened(padded_x: Plane, padded_y: Plane, soft: Plane) -> tuple[float, float, float]:
    """Return the entries xx, xy, yy of Σ (B g)(B g)ᵀ, where B is the blur and slopes g are 0 outside the patch.

    Blurred slopes are smooth: the sum runs over every second line only and is doubled. The slopes have padding above
    and below; `soft` is a buffer.
    """
    w0, w1, w2, w3 = BINOMIAL
    v0, v1, v2, v3 = _F32(w0 / 64), _F32(w1 / 64), _F32(w2 / 64), _F32(w3 / 64)
    p, count = PITCH_PX, (WINDOW_PX + 2 * BLUR_REACH) // 2
    soft_x, soft_y, room = soft[: (count + 1) * p], soft[(count + 1) * p :], 2 * BLUR_REACH
    for y in range(count):
        f, g = padded_x[2 * y * p : (2 * y + 7) * p], padded_y[2 * y * p : (2 * y + 7) * p]
        to_x, to_y = soft_x[y * p + room : (y + 1) * p + room], soft_y[y * p + room : (y + 1) * p + room]
        for x in range(p):
            near = v1 * (f[x + 2 * p] + f[x + 4 * p]) + v2 * (f[x + p] + f[x + 5 * p])
            to_x[x] = v0 * f[x + 3 * p] + near + v3 * (f[x] + f[x + 6 * p])
            near = v1 * (g[x + 2 * p] + g[x + 4 * p]) + v2 * (g[x + p] + g[x + 5 * p])
            to_y[x] = v0 * g[x + 3 * p] + near + v3 * (g[x] + g[x + 6 * p])
    xx = xy = yy = _F32(0)
    for n in range(count * p):
        u = v0 * soft_x[n + 3] + v1 * (soft_x[n + 2] + soft_x[n + 4])
        v = v0 * soft_y[n + 3] + v1 * (soft_y[n + 2] + soft_y[n + 4])
        u += v2 * (soft_x[n + 1] + soft_x[n + 5]) + v3 * (soft_x[n] + soft_x[n + 6])
        v += v2 * (soft_y[n + 1] + soft_y[n + 5]) + v3 * (soft_y[n] + soft_y[n + 6])
        xx += u * u
        xy += u * v
        yy += v * v
    return 2 * float(xx), 2 * float(xy), 2 * float(yy)


@inlined
def _bilinear(tile: Plane, x: float, y: float, patch: _Patch) -> tuple[float, float, float]:
    """Return the sums of s·t, s·gx, s·gy for the window s at (x, y) of a tile of image b, interpolated bilinearly."""
    t, gx, gy = patch[0], patch[1], patch[2]
    x0, y0, one = int(x), int(y), _F32(1)
    fx, fy = _F32(x - x0), _F32(y - y0)
    w00, w01, w10, w11 = (one - fx) * (one - fy), fx * (one - fy), (one - fx) * fy, fx * fy
    first = y0 * PITCH_PX + x0
    v = tile[first : first + _SIZE + PITCH_PX + 1]
    st = sx = sy = _F32(0)
    for n in range(_SIZE):
        s = w00 * v[n] + w01 * v[n + 1] + w10 * v[n + PITCH_PX] + w11 * v[n + PITCH_PX + 1]
        st += s * t[n]
        sx += s * gx[n]
        sy += s * gy[n]
    return float(st), float(sx), float(sy)


@inlined
def _sharp(
    tile: Plane, x: float, y: float, patch: _Patch, lines: Plane
) -> tuple[float, float, float, float, float, float, float]:
    """Return the sums of s, s·t, s·gx, s·gy, s·s, s·t·x, s·t·y for the window s at (x, y) of a tile of image b.

    The window is interpolated by the sinc of six points. `lines` is a buffer for the lines of the window.
    """
    t, gx, gy, tx, ty = patch
    x0, y0, p = int(x), int(y), PITCH_PX
    first, count = (y0 - 2) * p + x0 - 2, (WINDOW_PX + TAPS - 1) * p
    v = tile[first : first + count + TAPS - 1]
    w0, w1, w2, w3, w4, w5 = _weights(x - x0)
    for n in range(count):
        lines[n] = w0 * v[n] + w1 * v[n + 1] + w2 * v[n + 2] + w3 * v[n + 3] + w4 * v[n + 4] + w5 * v[n + 5]
    w0, w1, w2, w3, w4, w5 = _weights(y - y0)
    s1 = st = sx = sy = ss = su = sv = _F32(0)
    for n in range(_SIZE):
        s = w0 * lines[n] + w1 * lines[n + p] + w2 * lines[n + 2 * p]
        s += w3 * lines[n + 3 * p] + w4 * lines[n + 4 * p] + w5 * lines[n + 5 * p]
        inside = s * INSIDE[n]
        s1 += inside
        ss += s * inside
        st += s * t[n]
        sx += s * gx[n]
        sy += s * gy[n]
        su += s * tx[n]
        sv += s * ty[n]
    return float(s1), float(st), float(sx), float(sy), float(ss), float(su), float(sv)


@inlined
def _weights(f: float) -> tuple[float, float, float, float, float, float]:
    """Return the weights of the sinc's six points for a fraction f (0 … 1) of a pixel, interpolated in `SINC`."""
    at = f * FRACTIONS
    n = min(int(at), FRACTIONS - 1)
    # Number by number, because an expression of arrays would allocate three of them.
    g = _F32(at - n)
    w0, w1 = SINC[n, 0] + g * (SINC[n + 1, 0] - SINC[n, 0]), SINC[n, 1] + g * (SINC[n + 1, 1] - SINC[n, 1])
    w2, w3 = SINC[n, 2] + g * (SINC[n + 1, 2] - SINC[n, 2]), SINC[n, 3] + g * (SINC[n + 1, 3] - SINC[n, 3])
    w4, w5 = SINC[n, 4] + g * (SINC[n + 1, 4] - SINC[n, 4]), SINC[n, 5] + g * (SINC[n + 1, 5] - SINC[n, 5])
    return w0, w1, w2, w3, w4, w5
