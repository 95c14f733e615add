"""Sub-pixel matching of many small patches at once.

Two steps: pyramid-free Lucas-Kanade in OpenCV on a mosaic of tiles, which brings every patch within a
few hundredths of a pixel, then Gauss-Newton in float with gain and offset, which removes the rest and
yields the information matrix of every match. Tiles are blurred by 1.2 px first: that takes away most of
the interpolation's pull towards whole pixels.

**Light.** Vignetting and the fall of a lamp make a patch brighter on one side, in frame b often on the other:
a blob of 5 px then seems to move by 0.01 to 0.02 px, in all patches alike, so that it does not average out. The
slopes are therefore freed of what offset, gain and a slope of the gain across the patch can explain (t, t·x, t·y).

**Information.** With g the slopes so freed, H = Σ g·gᵀ, and noise that was white before the blur B, a match
scatters by H⁻¹·(s²·Σ (B g)(B g)ᵀ)·H⁻¹: slopes are smooth, and smooth noise is what the blur leaves. What remains of
the difference of the two patches has v² = s²·Σ B² = s² / (4π·1.2²), so s² follows from it. The
structure tensor over v² alone would be too sure by a factor of 4 to 14.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.lib.stride_tricks import sliding_window_view
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats

WINDOW_PX = 21
"""Side of the patch that is compared."""
TILE_PX = 37
"""Side of what is cut out around it: room for blur, interpolation and a wrong prediction."""
REACH_PX = 6.0
"""A patch that moves further from its prediction has lost its way."""
_BLUR_PX, _BLUR_REACH = 1.2, 5
_STEPS = 2
_TAPS, _KAISER = 6, 6.0
_SETTLED_PX = 0.1
"""The last step of a patch that found its place is shorter: else a good score is that of somewhere nearby."""
_SATURATED, _SATURATED_SHARE = 254, 0.02
_NOISE_FLOOR = 0.5
"""Grey levels; no camera is better after rounding to whole numbers and blurring."""


@dataclass(frozen=True, eq=False)
class Matches:
    """What came of each of k patches; `found` says which can be used at all."""

    b_px: Floats
    information: Floats
    score: Floats
    found: NDArray[np.bool_]


def fits(shape: tuple[int, ...], px: Floats) -> NDArray[np.bool_]:
    """Whether tiles around positions (k, 2) lie inside an image."""
    half = TILE_PX // 2
    at = np.round(px)
    limit = np.array([shape[1], shape[0]]) - half - 1
    return np.asarray(((at >= half) & (at <= limit)).all(-1))


def match(a: NDArray[np.uint8], b: NDArray[np.uint8], a_px: NDArray[np.int_], guess_px: Floats) -> Matches:
    """Find patches of image a in image b.

    Args:
        a: first image.
        b: second image.
        a_px: (k, 2) whole pixels in a, `fits(a)`.
        guess_px: (k, 2) where they are expected in b, `fits(b)`; right to a few pixels.
    """
    anchor = np.round(guess_px).astype(int)
    raw_a, raw_b = _tiles(a, a_px), _tiles(b, anchor)
    smooth_a, smooth_b = _smooth(raw_a), _smooth(raw_b)
    moved = _lucas_kanade(smooth_a, smooth_b, guess_px - anchor)
    tiles_a, tiles_b = (_unmosaic(m, len(a_px)) for m in (smooth_a, smooth_b))
    moved, information, score, settled = _gauss_newton(tiles_a, tiles_b, moved)
    b_px = anchor + moved
    near = np.abs(b_px - guess_px).max(-1) <= REACH_PX
    clear = ~_blown_out(raw_a) & ~_blown_out(raw_b)
    return Matches(b_px, information, score, near & clear & settled & np.isfinite(score))


def _tiles(image: NDArray[np.uint8], at: NDArray[np.int_]) -> NDArray[np.uint8]:
    half = TILE_PX // 2
    return np.asarray(sliding_window_view(image, (TILE_PX, TILE_PX))[at[:, 1] - half, at[:, 0] - half])


def _blown_out(tiles: NDArray[np.uint8]) -> NDArray[np.bool_]:
    """Whether so much of a patch is saturated that its edges have moved: clipping widens what is bright."""
    inner = slice(TILE_PX // 2 - WINDOW_PX // 2, TILE_PX // 2 + WINDOW_PX // 2 + 1)
    return np.asarray((tiles[:, inner, inner] >= _SATURATED).mean((1, 2)) > _SATURATED_SHARE)


def _across(count: int) -> int:
    return int(np.ceil(np.sqrt(count)))


def _smooth(tiles: NDArray[np.uint8]) -> NDArray[np.float32]:
    """All tiles side by side in one picture, blurred; the compared windows never touch the seams."""
    across = _across(len(tiles))
    down = -(-len(tiles) // across)
    full = np.zeros((down * across, TILE_PX, TILE_PX), dtype=np.float32)
    full[: len(tiles)] = tiles
    flat = full.reshape(down, across, TILE_PX, TILE_PX).swapaxes(1, 2).reshape(down * TILE_PX, across * TILE_PX)
    return np.asarray(cv2.GaussianBlur(flat, (0, 0), _BLUR_PX))


def _unmosaic(mosaic: NDArray[np.float32], count: int) -> NDArray[np.float32]:
    """The tiles (k, side, side) of a mosaic."""
    down, across = mosaic.shape[0] // TILE_PX, mosaic.shape[1] // TILE_PX
    tiles = mosaic.reshape(down, TILE_PX, across, TILE_PX).swapaxes(1, 2).reshape(-1, TILE_PX, TILE_PX)
    return np.ascontiguousarray(tiles[:count])


def _lucas_kanade(mosaic_a: NDArray[np.float32], mosaic_b: NDArray[np.float32], start: Floats) -> Floats:
    """Displacement (k, 2) of each tile's middle, by OpenCV, on the mosaics rounded to 8 bit."""
    n = np.arange(len(start))
    across = _across(len(start))
    middle = np.stack([n % across, n // across], -1) * TILE_PX + TILE_PX // 2
    points = middle.astype(np.float32).reshape(-1, 1, 2)
    first = (middle + start).astype(np.float32).reshape(-1, 1, 2)
    found, status, _ = cv2.calcOpticalFlowPyrLK(
        np.rint(mosaic_a).astype(np.uint8),
        np.rint(mosaic_b).astype(np.uint8),
        points,
        first,
        winSize=(WINDOW_PX, WINDOW_PX),
        maxLevel=0,
        flags=cv2.OPTFLOW_USE_INITIAL_FLOW,
        criteria=(cv2.TERM_CRITERIA_EPS | cv2.TERM_CRITERIA_COUNT, 20, 0.01),
        minEigThreshold=1e-6,
    )
    moved = found.reshape(-1, 2).astype(np.float64) - middle
    lost = (status.ravel() == 0) | (np.abs(moved - start).max(-1) > REACH_PX)
    return np.asarray(np.where(lost[:, None], start, moved))


def _gauss_newton(
    a: NDArray[np.float32], b: NDArray[np.float32], moved: Floats
) -> tuple[Floats, Floats, Floats, NDArray[np.bool_]]:
    """Refine displacements by inverse-compositional Gauss-Newton with gain and offset.

    Returns:
        moved (k, 2) px, inverse covariance (k, 2, 2) px⁻², score (k,), settled (k,).
    """
    half, w = TILE_PX // 2, WINDOW_PX // 2
    inner = slice(half - w, half + w + 1)
    gx = (a[:, inner, half - w + 1 : half + w + 2] - a[:, inner, half - w - 1 : half + w]) / 2
    gy = (a[:, half - w + 1 : half + w + 2, inner] - a[:, half - w - 1 : half + w, inner]) / 2
    k = len(a)
    t = a[:, inner, inner].reshape(k, -1)
    tm = t - t.mean(1, keepdims=True)
    norm = np.maximum((tm * tm).sum(1), 1e-6)
    slope: NDArray[np.float32] = np.stack([gx.reshape(k, -1), gy.reshape(k, -1)], 1)
    slope = _freed_of_light(slope, t, tm)
    hessian = (slope @ slope.swapaxes(1, 2)).astype(np.float64)
    inverse = np.linalg.inv(hessian + 1e-6 * np.eye(2))
    limit = TILE_PX // 2 - w - _TAPS / 2
    score = residual = np.zeros(k)
    delta = np.zeros((k, 2))
    for step in range(_STEPS + 1):
        moved = np.clip(moved, -limit, limit)
        s = _shifted(b, moved).reshape(k, -1)
        s -= s.mean(1, keepdims=True)
        gain = np.maximum((s * tm).sum(1) / norm, 1e-3)
        error = s / gain[:, None] - tm
        energy = np.maximum((s * s).sum(1), 1e-6)
        score = ((s * tm).sum(1) / np.sqrt(energy * norm)).astype(np.float64)
        residual = error.std(1).astype(np.float64)
        if step < _STEPS:
            delta = (inverse @ (slope @ error[:, :, None]).astype(np.float64))[:, :, 0]
            moved = moved - delta
    settled = np.abs(delta).max(-1) <= _SETTLED_PX
    noise = np.maximum(residual, _NOISE_FLOOR)
    return moved, _information(slope, hessian, noise), score, settled


def _freed_of_light(slope: NDArray[np.float32], t: NDArray[np.float32], tm: NDArray[np.float32]) -> NDArray[np.float32]:
    """Slopes (k, 2, n) without what an offset, a gain and its slope in x and y can explain in patches t (k, n)."""
    y, x = np.mgrid[-1 : 1 : WINDOW_PX * 1j, -1 : 1 : WINDOW_PX * 1j].reshape(2, -1).astype(np.float32)
    light = np.stack([np.ones_like(t), tm, t * x, t * y], 1)
    across = light.swapaxes(1, 2)
    share = np.linalg.solve(light @ across + 1e-3 * np.eye(4, dtype=np.float32), light @ slope.swapaxes(1, 2))
    return np.asarray(slope - share.swapaxes(1, 2) @ light)


def _information(slope: NDArray[np.float32], hessian: Floats, noise: Floats) -> Floats:
    """Inverse covariance (k, 2, 2) of matches, for slopes (k, 2, n) and scatter after the blur (k,)."""
    k, room = len(slope), WINDOW_PX + 2 * _BLUR_REACH
    apart = np.zeros((2 * k, room, WINDOW_PX), dtype=np.float32)
    apart[:, _BLUR_REACH:-_BLUR_REACH] = slope.reshape(2 * k, WINDOW_PX, WINDOW_PX)
    size = (2 * _BLUR_REACH + 1,) * 2
    soft = cv2.GaussianBlur(apart.reshape(-1, WINDOW_PX), size, _BLUR_PX, borderType=cv2.BORDER_CONSTANT)
    soft = soft.reshape(k, 2, -1)
    variance = 4 * np.pi * _BLUR_PX**2 * noise**2
    spread = (soft @ soft.swapaxes(1, 2)).astype(np.float64) * variance[:, None, None]
    return np.asarray(hessian @ np.linalg.inv(spread + 1e-9 * np.eye(2)) @ hessian)


def _shifted(b: NDArray[np.float32], moved: Floats) -> NDArray[np.float32]:
    """The window of every tile, moved by its own displacement (k, 2), by separable interpolation of six points."""
    k = len(b)
    half, w = TILE_PX // 2, WINDOW_PX // 2
    whole = np.floor(moved).astype(int)
    weights = _sinc((moved - whole).astype(np.float32))
    size = WINDOW_PX + _TAPS - 1
    x0, y0 = whole[:, 0] + half - w - _TAPS // 2 + 1, whole[:, 1] + half - w - _TAPS // 2 + 1
    view = sliding_window_view(b, (size, size), axis=(1, 2))
    cut = view[np.arange(k), y0, x0]
    rows = sum(cut[:, :, t : t + WINDOW_PX] * weights[:, 0, t, None, None] for t in range(_TAPS))
    return np.asarray(sum(rows[:, t : t + WINDOW_PX] * weights[:, 1, t, None, None] for t in range(_TAPS)))


def _sinc(f: NDArray[np.float32]) -> NDArray[np.float32]:
    """Weights (…, 6) of a sinc under a Kaiser window at fractions f: it moves blurred texture to 0.002 px."""
    at = np.arange(1 - _TAPS // 2, _TAPS // 2 + 1, dtype=np.float32) - f[..., None]
    window = np.i0(_KAISER * np.sqrt(np.maximum(1 - (at / (_TAPS / 2)) ** 2, 0)))
    weights = np.sinc(at) * window
    return np.asarray(weights / weights.sum(-1, keepdims=True), dtype=np.float32)
