"""The place of a mark to a few hundredths of a pixel.

Small circles by the intersection of their edge gradients (Förstner and Gülch 1987), every other mark by its
point symmetry: the centre about which the picture best equals itself turned by 180°. Neither depends
on brightness, gain or how much of the rim is bare; vignetting is estimated along with the symmetry.
"""

from __future__ import annotations

from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.marks.artwork import CROSS_ARM, Shape, coverage
from vaoi_station.marks.search import SURROUND

_STEPS = 6
_COARSE_SIDE = 24
"""Larger marks are first looked at through about so many samples per side."""
_SMOOTH_PX = 1.5
"""Blur before symmetry is judged: what aliasing the sensor left is out of it then."""
_TAPS = np.arange(-2, 4)
"""Pixels that a value between pixels is interpolated from."""
_ROUND_BY_SYMMETRY_PX = 24.0
"""From this size on the shading across a circle pulls its edge gradients; its symmetry has the last word."""
_LEAST_SCORE = 0.75
_LEAST_CONTRAST = 8.0


@dataclass(frozen=True)
class Mark:
    """A mark found: where, how surely, how alike the artwork, and whether it is light on dark."""

    px: Floats
    sigma_px: float
    score: float
    light: bool


def locate(
    image: NDArray[np.uint8],
    near_px: Floats,
    shape: Shape,
    size_px: float,
    *,
    arm: float = CROSS_ARM,
    surround: float = SURROUND,
    precise: bool = True,
) -> Mark | Failure:
    """Refine a mark near a place that is right to a third of its size.

    Args:
        image: (h, w) full frame.
        near_px: (2,) raw pixels.
        shape: of the mark.
        size_px: its size in this image.
        arm: width of a cross' arm as a share of its size.
        surround: diameter of what is compared with the artwork, in sizes: the mark and the bare rim around it.
        precise: circles can be had in a fifth of the time, to a few hundredths of a pixel, without it.
    """
    half = int(np.ceil(surround * size_px / 2)) + 4
    x, y = (round(float(v)) for v in near_px)
    if not (half <= x < image.shape[1] - half and half <= y < image.shape[0] - half):
        return Failure(f"the mark at ({x}, {y}) px is cut off by the frame's border")
    patch = image[y - half : y + half + 1, x - half : x + half + 1].astype(np.float32)
    start = np.array([half, half], dtype=np.float64) + (np.asarray(near_px) - (x, y))
    found = _round(patch, start, size_px, precise) if shape == "circle" else _by_symmetry(patch, start, size_px)
    if isinstance(found, Failure):
        return found
    center, sigma = found
    score, contrast = _likeness(
        patch, center, coverage(shape, size_px, patch.shape[0], _pair(center), arm), surround * size_px
    )
    if abs(contrast) < _LEAST_CONTRAST:
        return Failure(f"contrast {abs(contrast):.0f} of the mark at ({x}, {y}) px is below {_LEAST_CONTRAST:.0f}")
    if score < _LEAST_SCORE:
        return Failure(f"correlation {score:.2f} of the mark at ({x}, {y}) px is below {_LEAST_SCORE}")
    return Mark(center + (x - half, y - half), sigma, score, contrast > 0)


def _round(patch: NDArray[np.float32], start: Floats, size_px: float, precise: bool) -> tuple[Floats, float] | Failure:
    """Centre of a circle."""
    found = _by_gradients(patch, start, size_px)
    if isinstance(found, Failure) or not precise or size_px < _ROUND_BY_SYMMETRY_PX:
        return found
    better = _by_symmetry(patch, found[0], size_px)
    return found if isinstance(better, Failure) or np.abs(better[0] - found[0]).max() > 1 else better


def _by_gradients(patch: NDArray[np.float32], start: Floats, size_px: float) -> tuple[Floats, float] | Failure:
    """Centre of a circle: the point nearest to all lines along the gradients of its edge."""
    smooth = cv2.GaussianBlur(patch, (0, 0), 0.8)
    gx, gy = ((smooth[1:-1, 2:] - smooth[1:-1, :-2]) / 2).ravel(), ((smooth[2:, 1:-1] - smooth[:-2, 1:-1]) / 2).ravel()
    side = patch.shape[0] - 2
    middle = (side - 1) / 2
    at = np.arange(side, dtype=np.float32) - np.float32(middle)
    x, y = np.tile(at, side), np.repeat(at, side)
    a, b, c = gy * gy, gx * gy, gx * gx
    sums = np.stack([a, -b, c, a * x - b * y, c * y - b * x])
    begin = start - 1 - middle
    center, normal, w = begin, np.eye(2), np.ones_like(x)
    for _ in range(_STEPS):
        r = np.sqrt((x - np.float32(center[0])) ** 2 + (y - np.float32(center[1])) ** 2)
        w = np.exp(-0.5 * ((r - np.float32(size_px / 2)) / np.float32(max(0.1 * size_px, 1.5))) ** 2)
        aa, ab, bb, ra, rb = (float(v) for v in sums @ w)
        normal = np.array([[aa, ab], [ab, bb]])
        determinant = aa * bb - ab * ab
        if determinant < 1e-6 * max(aa + bb, 1e-6) ** 2:
            return Failure("no round edge: the gradients run all one way")
        moved = np.array([bb * ra - ab * rb, aa * rb - ab * ra]) / determinant
        if np.abs(moved - begin).max() > size_px / 3 + 2:
            return Failure("no round edge near the predicted place")
        center, step = moved, float(np.abs(moved - center).max())
        if step < 1e-3:
            break
    offset = gy * (x - np.float32(center[0])) - gx * (y - np.float32(center[1]))
    spread = np.linalg.inv(normal) * float((w * w * offset * offset).sum()) / max(float(w.sum()), 1e-9)
    return center + 1 + middle, float(np.sqrt(max(np.trace(spread) / 2, 0.005**2)))


def _by_symmetry(patch: NDArray[np.float32], start: Floats, size_px: float) -> tuple[Floats, float] | Failure:
    """Centre of point symmetry: Gauss-Newton on I(c + u) − I(c − u), on few points first and then on all.

    A gain that rises by a share a per pixel across the mark adds 2·a·u times the mean of the two, odd in u like
    the trace of a shift; a is estimated too, so that vignetting pulls nothing.
    """
    reach, coarse = int(np.ceil(0.62 * size_px)) + 1, max(round(size_px / _COARSE_SIDE), 1)
    furthest = size_px / 3 + 2
    pad = int(furthest) + len(_TAPS)
    smooth = cv2.GaussianBlur(patch, (0, 0), _SMOOTH_PX)
    smooth = cv2.copyMakeBorder(smooth, pad, pad, pad, pad, cv2.BORDER_REPLICATE)
    center, spread = start, np.eye(2)
    for stride, enough in ((coarse, 0.05), (1, 1e-3)) if coarse > 1 else ((1, 1e-3),):
        for _ in range(3 * _STEPS):
            step = _symmetry_step(smooth, center + pad, reach, stride)
            if step is None:
                return Failure("no point symmetry: the picture changes in one direction only")
            move, spread = step
            center = center - np.clip(move, -1.5, 1.5)
            if np.abs(center - start).max() > furthest:
                return Failure("no centre of symmetry near the predicted place")
            if np.abs(move).max() < enough:
                break
    return center, float(np.sqrt(max(np.trace(spread) / 2, 0.005**2)))


def _symmetry_step(
    smooth: NDArray[np.float32], center: Floats, reach: int, stride: int
) -> tuple[Floats, Floats] | None:
    """How far the centre of symmetry is from `center` (2,), and the covariance (2, 2); None if nothing fixes it."""
    window = _centred(smooth, center, reach + 1)
    pick = np.s_[1:-1:stride, 1:-1:stride]
    ahead, behind = window[pick], window[::-1, ::-1][pick]
    slopes = []
    for dx, dy in ((1, 0), (0, 1)):
        slope = cv2.Sobel(window, cv2.CV_32F, dx, dy, ksize=3, scale=1 / 8)
        slopes.append(slope[pick] - slope[::-1, ::-1][pick])
    side = np.arange(-reach, reach + 1, stride, dtype=np.float32) / np.float32(2 * reach)
    e, total = ahead - behind, ahead + behind
    columns = np.stack([*slopes, side[None] * total, side[:, None] * total]).reshape(4, -1)
    normal = (columns @ columns.T).astype(np.float64)
    if np.linalg.det(normal[:2, :2]) < 1e-6 * max(np.trace(normal[:2, :2]), 1e-6) ** 2:
        return None
    normal[[2, 3], [2, 3]] *= 1 + 1e-6
    inverse = np.linalg.inv(normal)
    solution = inverse @ (columns @ e.ravel()).astype(np.float64)
    left = e.ravel() - solution.astype(np.float32) @ columns
    return solution[:2], inverse[:2, :2] * float((left * left).mean()) * stride**2


def _centred(image: NDArray[np.float32], center: Floats, reach: int) -> NDArray[np.float32]:
    """The square of 2·reach + 1 pixels about a place between pixels, by Lagrange's interpolation over six of them.

    Bilinear interpolation errs in the third derivative, and with opposite signs on opposite edges of a mark.
    """
    x, y = (int(v) for v in np.floor(center))
    before, after = reach - int(_TAPS[0]), reach + int(_TAPS[-1]) + 1
    cut = image[y - before : y + after, x - before : x + after]
    kernels = [_lagrange(float(c - np.floor(c))) for c in center]
    moved = cv2.sepFilter2D(cut, cv2.CV_32F, kernels[0], kernels[1], anchor=(int(-_TAPS[0]), int(-_TAPS[0])))
    low = before - reach
    return np.asarray(moved[low : low + 2 * reach + 1, low : low + 2 * reach + 1])


def _lagrange(fraction: float) -> NDArray[np.float64]:
    """Weights of the pixels at `_TAPS` for a place `fraction` behind the pixel at 0."""
    apart = _TAPS[:, None] - _TAPS[None] + np.eye(len(_TAPS))
    ways = np.where(np.eye(len(_TAPS), dtype=bool), 1.0, fraction - _TAPS[None])
    return np.asarray(ways.prod(1) / apart.prod(1))


def _likeness(
    patch: NDArray[np.float32], center: Floats, artwork: NDArray[np.float32], disc_px: float
) -> tuple[float, float]:
    """Correlation with the artwork at the place found, and contrast (light minus dark) in grey levels."""
    ideal = cv2.GaussianBlur(artwork, (0, 0), 0.7)
    weight = coverage("circle", disc_px, patch.shape[0], _pair(center))
    p, q = patch - np.average(patch, weights=weight), ideal - np.average(ideal, weights=weight)
    norm = float((weight * q * q).sum())
    gain = float((weight * p * q).sum()) / max(norm, 1e-9)
    return abs(gain) * float(np.sqrt(norm / max(float((weight * p * p).sum()), 1e-9))), gain


def _pair(center: Floats) -> tuple[float, float]:
    return float(center[0]), float(center[1])
