"""The hard edge of a shadow across a mark: it is found in the odd part of the image, and the light is made even.

The shadow of a tall part ends in a step of the light. Near a mark's edge or across the mark, such a step displaces the
fitted centre by tenths of a pixel, because the fits know only a gradient of the light. An undisturbed mark is point
symmetric about its centre c, so the differences I(c + u) − I(c − u) consist of an error of c, the gradient, and the
step. A coarse search in the linearised differences finds likely lines of the step. Line and step are then refined until
the image with even light is as symmetric as possible. The opposite step on the opposite side has the same differences:
either may be found, and both give the same centre.
"""

from __future__ import annotations

import math
from collections.abc import Callable, Sequence
from operator import itemgetter
from typing import NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats
from vaoi_station.marks.template_correlation import outside_shape

EDGE_PX = 2.0
"""Distance outside a mark's edge at which its blur ends."""
_REACH = 0.85
"""Radius of the compared disc, as a share of the radius of mark and bare rim: more copper may lie close to them."""
_BLUR_PX, _TAPS = 0.8, 3
"""Blur before the comparison, and the pixels on each side that it uses.

Without it, edges between pixels would look asymmetric."""
_SHARP_PX = 0.67
"""Blur of the edge of a shadow in a sharp frame."""
_LOGISTIC = 1.702
"""The logistic function of this multiple of z differs from the normal distribution function by less than 0.01."""
_DIRECTIONS, _OFFSETS, _OFFSET_PX = 24, 12, 1.0
"""Number of searched directions, largest number of lines in each, and the least distance of these lines, px."""
_SEARCHED = 300
"""Largest number of pixels in which lines are searched."""
_LEAST_CHI2, _LEAST_SHARE = 20.0, 0.8
"""A step counts if its χ² is larger, and if it explains this share of the differences beyond noise.

On 1500 undisturbed marks with noise χ² is 13 at most. Smudges and copper beside a mark leave more unexplained."""
_LEAST_STEP, _LARGEST_STEP = 0.02, 0.4
"""Smallest and largest share of the light that a shadow takes away."""
_LINES = 12
"""Number of lines above a mark's centre in which its light is compared at least."""
_LARGEST_SHARE, _LARGEST_NOISE, _OTHER = _LARGEST_STEP / (2 - _LARGEST_STEP), 12.0, 0.01
"""Largest difference of opposite pixels by a shadow, as a share of their sum; what noise adds to it, grey levels; and
the share of pixels beyond both that excludes a shadow."""
_LEAST_NOISE = 0.5
"""Least standard deviation of a pixel, grey levels, as the grey levels are rounded."""
_USUAL_GRADIENT, _USUAL_CHANGE = 0.001, 0.04
"""Usual gradient of the light, share per px, and usual change from the centre to the end of the compared disc."""
_REFINEMENTS, _PATIENCE = 7, 3
"""Largest number of refinements, and the number after which a poor one ends."""
_RANGES, _LEAST_FIRST_SHARE, _LIKELY_STEP = 5, 0.5, 0.9 * _LEAST_STEP
"""Number of ranges of distances from which a step is refined, and the least depth of the steps that are.

Others than the best are refined if the best explains this share of the differences beyond noise. Of 776 painted marks
with shadows of 2 to 30 % the best explains 0.80 at least, and the deepest likely step is 0.023."""
_DELTA = np.array([0.02, 0.1, 0.01])
"""Differences of angle (rad), offset (px) and step from which derivatives are computed."""
_LARGEST_CHANGE, _ENOUGH = np.array([0.3, 1.5, 0.15]), np.array([0.003, 0.01, 0.001])
"""Largest change of angle, offset and step in one refinement, and the change that ends the refinements."""


class ShadowEdge(NamedTuple):
    """A step of the light: it is 1 + `step` times as bright where n·u > `offset_px`, with n = (cos, sin) of `angle`."""

    angle: float
    offset_px: float
    """Distance of the line from the centre of the comparison."""
    step: float

    def light(self, u: Floats, v: Floats) -> Floats:
        """Return the brightness at the offsets (u, v) from the centre as a share of that on the brighter side."""
        across = (u * math.cos(self.angle) + v * math.sin(self.angle) - self.offset_px) / _SHARP_PX
        beyond = 1 / (1 + np.exp(np.clip(-_LOGISTIC * across, -50, 50)))
        return np.asarray((1 + self.step * beyond) / max(1 + self.step, 1.0))

    @property
    def depth(self) -> float:
        """Share of the light that the shadow takes away."""
        return abs(self.step) / max(1 + self.step, 1.0)


def compared_reach_px(size_px: float, surround: float) -> float:
    """Return the radius of the disc in which opposite pixels are compared; `surround` is that of `locate_mark`."""
    rim = surround * size_px / 2
    return max(_REACH * rim, min(rim, size_px / 2 + EDGE_PX))


@compiled
def light_unevenness(
    image: NDArray[np.uint8], x: float, y: float, code: int, size: float, arm: float, reach: float
) -> tuple[float, float]:
    """Compare the gradient of the light on a mark with that on the ground around it; in plain light both are equal.

    Returns χ² (two degrees of freedom) of their difference, or of what the gradient on the ground has beyond usual ones
    if that is larger, and the standard deviation of a pixel by noise in grey levels; 0 and infinity without ground in
    `reach`, or if copper or a cover on one side changes more than a shadow can. Arguments as in `correlate_with_shape`.
    """
    # Lines: ground and mark. Columns: normal equations xx, xy, yy, xe, ye of the gradient; sum of noise, count.
    sums, other = np.zeros((2, 7)), 0
    r, thin = 0.5 * size, 0.5 * size * arm
    # The opposite point (x − u, y − v) lies between pixels, so it is interpolated bilinearly.
    right, below = 2 * x - math.floor(2 * x), 2 * y - math.floor(2 * y)
    # Large marks have enough pixels in every second or third line.
    stride = max(round(reach / _LINES), 1)
    for row in range(max(math.ceil(y - reach), 1), min(math.floor(y), image.shape[0] - 1) + 1, stride):
        v, far = row - y, math.floor(2 * y) - row
        if far >= image.shape[0] - 1:
            continue
        wide = math.sqrt(max(reach * reach - v * v, 0.0))
        for column in range(max(math.ceil(x - wide), 1), min(math.floor(x + wide), image.shape[1] - 1) + 1):
            u, j = column - x, math.floor(2 * x) - column
            outside = outside_shape(code, abs(u), abs(v), math.sqrt(u * u + v * v), r, thin)
            if abs(outside) < EDGE_PX or j < 0 or j >= image.shape[1] - 1:
                continue
            here = float(image[row, column])
            top = image[far, j] * (1 - right) + image[far, j + 1] * right
            low = image[far + 1, j] * (1 - right) + image[far + 1, j + 1] * right
            opposite = top * (1 - below) + low * below
            e, c, d = here - opposite, u * (here + opposite), v * (here + opposite)
            of = sums[1 if outside < 0 else 0]
            of[0] += c * c
            of[1] += c * d
            of[2] += d * d
            of[3] += c * e
            of[4] += d * e
            # The mixed difference of four neighbours does not depend on gradients of the light.
            of[5] += abs(here - image[row, column - 1] - float(image[row - 1, column]) + image[row - 1, column - 1])
            of[6] += 1
            other += abs(e) > _LARGEST_SHARE * (here + opposite) + _LARGEST_NOISE
    # For normally distributed values the mean absolute value is √(2/π) of the standard deviation.
    noise = max(math.sqrt(math.pi / 8) * (sums[0, 5] + sums[1, 5]) / max(sums[0, 6] + sums[1, 6], 1.0), _LEAST_NOISE)
    if sums[0, 0] * sums[0, 2] - sums[0, 1] ** 2 <= 1e-6 * sums[0, 0] * sums[0, 2]:
        return 0.0, np.inf
    if other > _OTHER * (sums[0, 6] + sums[1, 6]):
        return 0.0, np.inf
    # Without pixels inside a small mark, the gradient on it is that of usual light.
    for k in range(2):
        for n in range(5):
            sums[k, n] /= 2 * noise * noise
    sums[1, 0] += 1 / _USUAL_GRADIENT**2
    sums[1, 2] += 1 / _USUAL_GRADIENT**2
    dx = dy = xx = xy = yy = steep = 0.0
    for k in range(2):
        a, b, c, d, e = sums[k, 0], sums[k, 1], sums[k, 2], sums[k, 3], sums[k, 4]
        det, sign = a * c - b * b, 1.0 - 2.0 * k
        dx += sign * (c * d - b * e) / det
        dy += sign * (a * e - b * d) / det
        xx += c / det
        xy -= b / det
        yy += a / det
        if k == 0:
            # A step can have the same gradient on mark and ground.
            steep = max(math.sqrt(dx * dx + dy * dy) - _USUAL_CHANGE / reach, 0.0) ** 2 * 2 / (xx + yy)
    return max((yy * dx * dx - 2 * xy * dx * dy + xx * dy * dy) / (xx * yy - xy * xy), steep), noise


class _Comparison(NamedTuple):
    """The pixels that are compared with their opposite ones: a patch, its centre, and offsets (u, v) from it."""

    patch: NDArray[np.float32]
    centre: tuple[float, float]
    half: int
    used: NDArray[np.bool_]
    u: Floats
    v: Floats

    def differences(self, image: NDArray[np.float32]) -> tuple[Floats, Floats, Floats]:
        """Return differences and sums of opposite pixels of an image of the patch, (n,) each.

        The last value (n, 4) has the effects of a shift along x and y, px, and of a gradient of the light.
        """
        window = _smooth_window(image, *self.centre, self.half + 1)
        here = window[1:-1, 1:-1]
        slopes = (window[1:-1, 2:] - window[1:-1, :-2], window[2:, 1:-1] - window[:-2, 1:-1])
        odd, both = ((here + sign * here[::-1, ::-1])[self.used] for sign in (-1, 1))
        shifts = [(s - s[::-1, ::-1])[self.used] for s in slopes]
        return odd, both, np.stack([*shifts, self.u * both, self.v * both], -1)


def _smooth_window(image: NDArray[np.float32], x: float, y: float, half: int) -> Floats:
    """Return the square of 2·half + 1 pixels about (x, y) of the smoothed image.

    The smoothing kernel is displaced by the fraction of a pixel, so nothing needs to be interpolated.
    """
    column, row = round(x), round(y)
    taps = np.arange(-_TAPS, _TAPS + 1)
    across, down = (np.exp(-((taps - fraction) ** 2) / (2 * _BLUR_PX**2)) for fraction in (x - column, y - row))
    part = image[row - half - _TAPS : row + half + _TAPS + 1, column - half - _TAPS : column + half + _TAPS + 1]
    smooth = cv2.sepFilter2D(part, cv2.CV_32F, across / across.sum(), down / down.sum())
    return np.asarray(smooth[_TAPS:-_TAPS, _TAPS:-_TAPS], np.float64)


def find_shadow_edge(
    patch: NDArray[np.uint8], centre: tuple[float, float], radius: float, reach: float, noise: float
) -> tuple[ShadowEdge, float] | None:
    """Find the step of the light across a mark; None if there is none that counts, or if the patch is too small.

    The second value is the factor by which the unknown line and step make the centre less certain: close to an edge of
    the mark that is parallel to it, the line of a shadow has nearly the effect of a shift. `patch` (h, w) reaches up to
    5 px beyond `reach` from the fitted `centre` (x, y); `noise` is that of a pixel in grey levels.
    """
    half = math.ceil(reach)
    needed, (h, w) = half + 1 + _TAPS, patch.shape
    if not (needed <= round(centre[0]) < w - needed and needed <= round(centre[1]) < h - needed):
        return None
    v, u = np.mgrid[-half : half + 1, -half : half + 1].astype(np.float64)
    # Opposite pixels give the same difference with opposite sign, so one half suffices.
    used = (u**2 + v**2 < reach**2) & ((v < 0) | ((v == 0) & (u < 0)))
    compared = _Comparison(patch.astype(np.float32), centre, half, used, u[used], v[used])
    lines, chi2 = _likely_lines(compared, min(radius + EDGE_PX, reach - 1), noise)
    lines = [line for line in lines if line.depth >= _LIKELY_STEP]
    if not chi2 > _LEAST_CHI2 or not lines:
        return None
    edge, share = _refine(compared, lines, noise)
    if share <= _LEAST_SHARE or not _LEAST_STEP <= edge.depth <= _LARGEST_STEP:
        return None
    return edge, _weakening(compared, edge)


def _weakening(compared: _Comparison, edge: ShadowEdge) -> float:
    """Return by which factor the centre is less certain if line and step are unknown too; at least 1."""
    u, v = _offsets(compared.patch.shape, compared.centre)

    def odd(of: ShadowEdge) -> tuple[Floats, Floats]:
        differences, _, effects = compared.differences(np.asarray(compared.patch / of.light(u, v), np.float32))
        return differences, effects

    now, known = odd(edge)
    slopes = [odd(ShadowEdge(*(edge + _DELTA * axis)))[0] - now for axis in np.eye(3)]
    both = np.column_stack([known, *slopes])
    both, known = (a / np.maximum(np.linalg.norm(a, axis=0), 1e-9) for a in (both, known))
    alone, together = (np.linalg.inv(a.T @ a + 1e-9 * np.eye(a.shape[1]))[:2, :2] for a in (known, both))
    return float(np.sqrt(max(np.linalg.eigvals(np.linalg.solve(alone, together)).real.max(), 1.0)))


def _likely_lines(compared: _Comparison, furthest: float, noise: float) -> tuple[list[ShadowEdge], float]:
    """Return the steps of the light that explain most of the differences, best first, and the χ² of the best one.

    There is one for each range of distances from the centre, because a step and a shift together look like another step
    beside the edge of a mark.
    """
    # The time is that of the number of lines times that of the pixels. A part of a large mark's pixels suffices.
    each = slice(None, None, math.ceil(len(compared.u) / _SEARCHED))
    odd, both, effects = (values[each] for values in compared.differences(compared.patch))
    basis, _ = np.linalg.qr(effects)
    left = odd - basis @ (basis.T @ odd)
    angles = np.arange(_DIRECTIONS) * (2 * math.pi / _DIRECTIONS)
    offsets = np.linspace(0, furthest, min(math.ceil(furthest / _OFFSET_PX) + 1, _OFFSETS))
    along = np.cos(angles)[:, None] * compared.u[each] + np.sin(angles)[:, None] * compared.v[each]
    # A ramp of the same slope is computed faster than the blurred edge.
    ramp = 1 / (math.sqrt(2 * math.pi) * math.hypot(_SHARP_PX, _BLUR_PX))
    along, lines = ramp * along[:, None], ramp * offsets[:, None]
    steps = np.clip(0.5 + along - lines, 0, 1) - np.clip(0.5 - along - lines, 0, 1)
    steps = (steps * (both / 2)).reshape(-1, len(odd))
    seen = steps @ basis
    power = (steps**2).sum(1) - (seen**2).sum(1)
    effect = steps @ left
    # A line counts only if its effect differs from that of a shift and a gradient.
    explained = np.where(power > 1e-3 * (steps**2).sum(1), effect**2 / np.maximum(power, 1e-9), 0.0)
    # With the step s of the light, the differences are s / (1 + s / 2) of the mean brightness.
    coefficients = np.clip(effect / np.maximum(power, 1e-9), -0.5, 0.5)
    table = explained.reshape(_DIRECTIONS, -1)
    best = []
    for near in np.array_split(np.arange(len(offsets)), _RANGES):
        direction, line = np.unravel_index(int(table[:, near].argmax()), (_DIRECTIONS, len(near)))
        number = int(direction) * len(offsets) + int(near[line])
        step = 2 * coefficients[number] / (2 - coefficients[number])
        edge = ShadowEdge(float(angles[direction]), float(offsets[near[line]]), float(step))
        best.append((float(explained[number]), edge))
    best.sort(key=itemgetter(0), reverse=True)
    return [edge for _, edge in best], best[0][0] / (2 * noise**2)


def _refine(compared: _Comparison, likely: Sequence[ShadowEdge], noise: float) -> tuple[ShadowEdge, float]:
    """Refine the likely steps; return the best with the share of the differences that it explains."""
    u, v = _offsets(compared.patch.shape, compared.centre)

    def rest(of: ShadowEdge) -> Floats:
        """Compute what remains of the differences in even light, beyond a shift and a gradient."""
        odd, _, effects = compared.differences(np.asarray(compared.patch / of.light(u, v), np.float32))
        basis, _ = np.linalg.qr(effects)
        return np.asarray(odd - basis @ (basis.T @ odd))

    before = rest(ShadowEdge(0.0, 0.0, 0.0))
    total = float(before @ before)
    beyond_noise = max(total - 2 * noise**2 / (4 * math.pi * _BLUR_PX**2) * len(before), 0.1 * total)
    edge, left = _minimise(rest, likely[0], total)
    if total - left > _LEAST_FIRST_SHARE * beyond_noise:
        for other in likely[1:]:
            refined, remaining = _minimise(rest, other, left)
            if remaining < left:
                edge, left = refined, remaining
    return edge, (total - left) / beyond_noise


def _minimise(rest: Callable[[ShadowEdge], Floats], edge: ShadowEdge, best: float) -> tuple[ShadowEdge, float]:
    """Minimise the square sum of `rest` by damped Gauss-Newton steps; return the step of the light and that sum.

    It gives up early if the sum stays far above `best`.
    """
    now, damping = rest(edge), 1e-3
    for number in range(_REFINEMENTS):
        if number == _PATIENCE and now @ now > 2 * best:
            break
        slopes = np.stack([rest(ShadowEdge(*(edge + _DELTA * axis))) - now for axis in np.eye(3)], -1) / _DELTA
        normal = slopes.T @ slopes
        damped = normal + np.diag(damping * np.diag(normal) + 1e-9)
        change = np.clip(-np.linalg.solve(damped, slopes.T @ now), -_LARGEST_CHANGE, _LARGEST_CHANGE)
        tried = ShadowEdge(*(float(p) for p in edge + change))
        if tried.depth > 2 * _LARGEST_STEP:
            break
        then = rest(tried)
        if then @ then >= now @ now:
            damping = max(30 * damping, 0.1)
            continue
        edge, now = tried, then
        if (np.abs(change) < _ENOUGH).all():
            break
    return edge, float(now @ now)


def even_light(patch: NDArray[np.uint8], centre: tuple[float, float], edge: ShadowEdge) -> NDArray[np.uint8]:
    """Return a patch whose brighter side is darkened to the brightness of the shadow, so that nothing saturates."""
    share = (1 - edge.depth) / edge.light(*_offsets(patch.shape, centre))
    even: NDArray[np.uint8] = np.rint(patch * share).astype(np.uint8)
    even.flags.writeable = False
    return even


def _offsets(shape: tuple[int, ...], centre: tuple[float, float]) -> tuple[Floats, Floats]:
    """Return the offsets of a patch's pixels from its centre along x (1, w) and along y (h, 1)."""
    across, down = np.arange(shape[1], dtype=np.float64), np.arange(shape[0], dtype=np.float64)
    return across[None] - centre[0], down[:, None] - centre[1]
