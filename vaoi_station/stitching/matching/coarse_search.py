"""The coarse step: by how much the real motion differs from the nominal one, to a pixel or two.

One correlation of the overlap, high-passed and small, within the range a belt may wander. Where the overlap allows it
is made at half the size as well: alone if it is wide, else to tell where at full size it is worth looking.
"""

from __future__ import annotations

import math
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.matching.prepared_frame import PreparedFrame

_LEAST_SCORE = 0.25
_AMPLE_PX = 24
"""An overlap that is so wide even at half the size is searched there only: a quarter of the pixels, at a quarter of the
places; one that is half as wide is searched there first …"""
_PEAKS, _RIVAL, _AROUND_PX = 4, 0.8, 2
"""… and then at full size around so many of its peaks that are nearly as high as the highest, so far to either side."""
_DIRECT = 1_200_000
"""Products up to which correlations are summed up one by one; beyond, OpenCV's Fourier transform is faster."""
_LEAST_CONTRAST = 1.0
"""Grey levels (rms) of texture below which an overlap counts as empty."""

Small = NDArray[np.float32]


@dataclass(frozen=True)
class CoarseShift:
    """Frame-b pixels to add to the nominal prediction."""

    px: Floats
    score: float


class NoMatch(Failure):
    """There is texture, but it is not in the other frame."""


def find_shift(
    a: PreparedFrame, b: PreparedFrame, box: tuple[int, int, int, int], offset_px: Floats, reach_px: Floats
) -> CoarseShift | Failure:
    """Find how far content of frame a has moved beyond the prediction.

    Args:
        a: frame whose overlap is looked for.
        b: frame in which it is looked for.
        box: the overlap in frame a, x0, y0, x1, y1.
        offset_px: predicted b − a in the middle of the overlap, (2,).
        reach_px: how far it may be off in x and y, (2,).
    """
    narrow = min(box[2] - box[0], box[3] - box[1])
    wide = narrow >= _AMPLE_PX * 2 * a.factor
    f, coarse_a, coarse_b = (2 * a.factor, a.coarser, b.coarser) if wide else (a.factor, a.coarse, b.coarse)
    template = _cut(coarse_a, box, f)
    if min(template.shape, default=0) < 4:
        return Failure(f"the overlap of {box[2] - box[0]}×{box[3] - box[1]} px is too narrow to search in")
    template = np.ascontiguousarray(template)
    contrast = math.sqrt(float(np.vdot(template, template)) / template.size)
    if contrast < _LEAST_CONTRAST:
        return Failure(f"the overlap is empty: contrast {contrast:.1f} grey levels")
    if wide or narrow < _AMPLE_PX * a.factor:
        peaks = _peaks(template, coarse_b, box, f, offset_px, reach_px, 1)
    else:
        around = np.full(2, float(_AROUND_PX * f))
        first = _peaks(_cut(a.coarser, box, 2 * f), b.coarser, box, 2 * f, offset_px, reach_px, _PEAKS)
        rivals = [shift * 2 * f for score, shift in first if score >= _RIVAL * first[0][0]]
        found = [_peaks(template, coarse_b, box, f, shift_px, around, 1) for shift_px in rivals or [offset_px]]
        peaks = sorted((peak for one in found for peak in one), key=lambda peak: -peak[0])
    score, shift = peaks[0]
    if score < _LEAST_SCORE:
        return NoMatch(f"no place within ±{reach_px[0]:.0f}, ±{reach_px[1]:.0f} px fits: best correlation {score:.2f}")
    return CoarseShift(shift * f - offset_px, score)


def _cut(coarse: Small, box: tuple[int, int, int, int], factor: int) -> Small:
    x0, y0, x1, y1 = (round(v / factor) for v in box)
    return coarse[y0:y1, x0:x1]


def _peaks(
    template: Small,
    image: Small,
    box: tuple[int, int, int, int],
    factor: int,
    offset_px: Floats,
    reach_px: Floats,
    most: int,
) -> list[tuple[float, Floats]]:
    """The best correlations and the shifts (2,) that give them, in pixels of the image, the best first."""
    reach_x, reach_y = (max(math.ceil(v / factor) + 1, 2) for v in reach_px.tolist())  # the best place has neighbours
    shift_x, shift_y = (round(v / factor) for v in offset_px.tolist())
    left, top = round(box[0] / factor) + shift_x - reach_x, round(box[1] / factor) + shift_y - reach_y
    window = _window(image, left, top, template.shape[1] + 2 * reach_x, template.shape[0] + 2 * reach_y)
    if template.size * (2 * reach_x + 1) * (2 * reach_y + 1) <= _DIRECT:
        surface = correlations(np.ascontiguousarray(template), window)
    else:
        surface = cv2.matchTemplate(window, template, cv2.TM_CCORR_NORMED)
        surface = np.nan_to_num(surface, nan=0.0, posinf=0.0, neginf=0.0)
    return [
        (score, np.array([x - reach_x + shift_x, y - reach_y + shift_y]))
        for score, x, y in best_peaks(np.ascontiguousarray(surface), most).tolist()
    ]


@compiled
def correlations(template: Small, window: Small) -> Small:
    """Normalised cross-correlation (without taking means off) of a template (h, w) at every place of a window.

    Returns:
        (H − h + 1, W − w + 1); 0 where the window is empty.
    """
    h, w = template.shape
    lines, pitch = window.shape
    ny, nx = lines - h + 1, pitch - w + 1
    weights, grey = np.zeros(h * pitch, np.float32), np.zeros((lines + 1) * pitch, np.float32)
    own = 0.0
    for y in range(h):
        for x in range(w):
            weights[y * pitch + x] = template[y, x]
            own += template[y, x] * template[y, x]
    energy, total = np.zeros((lines, nx)), np.zeros(nx)
    for y in range(lines):
        squares = 0.0
        for x in range(pitch):
            v = window[y, x]
            grey[y * pitch + x] = v
            squares += v * v
            if x >= w - 1:
                energy[y, x - w + 1] = squares
                first = window[y, x - w + 1]
                squares -= first * first
    for y in range(h - 1):
        total += energy[y]
    out = np.zeros((ny, nx), np.float32)
    for y in range(ny):
        total += energy[y + h - 1]
        for x in range(nx):
            part = grey[y * pitch + x : y * pitch + x + h * pitch]
            product = np.float32(0)
            for n in range(h * pitch):
                product += weights[n] * part[n]
            if total[x] > 1e-6 * own:
                out[y, x] = product / math.sqrt(total[x] * own)
        total -= energy[y]
    return out


@compiled
def best_peaks(surface: Small, most: int) -> Floats:
    """The highest maxima of a surface, so many: (k, 3) height, and place by parabolas through the neighbours."""
    rows, columns = surface.shape
    found, count = np.zeros((most, 3)), 0
    for y in range(rows):
        for x in range(columns):
            height = surface[y, x]
            at = count
            while at > 0 and height > found[at - 1, 0]:
                at -= 1
            if at == most or not _tops(surface, x, y):
                continue
            count = min(count + 1, most)
            for k in range(count - 1, at, -1):
                found[k] = found[k - 1]
            found[at, 0] = height
            found[at, 1], found[at, 2] = x + _vertex(surface[y], x), y + _vertex(surface[:, x], y)
    return found[:count]


@inlined
def _tops(surface: Small, x: int, y: int) -> bool:
    """Whether a sample is above all its neighbours; of several that are equal the first is."""
    rows, columns = surface.shape
    for i in range(max(y - 1, 0), min(y + 2, rows)):
        for j in range(max(x - 1, 0), min(x + 2, columns)):
            earlier = i < y or (i == y and j < x)
            if surface[i, j] > surface[y, x] or (earlier and surface[i, j] == surface[y, x]):
                return False
    return True


@inlined
def _vertex(line: Small, k: int) -> float:
    """By how much the maximum lies beside sample k, by a parabola through its neighbours."""
    if not 0 < k < len(line) - 1:
        return 0.0
    bend = line[k - 1] - 2 * line[k] + line[k + 1]
    return 0.5 * (line[k - 1] - line[k + 1]) / bend if bend < 0 else 0.0


def _window(image: Small, left: int, top: int, width: int, height: int) -> Small:
    """A part of an image, with zeros (no texture) where it reaches beyond."""
    h, w = image.shape
    out = np.zeros((height, width), dtype=np.float32)
    xa, ya, xb, yb = max(left, 0), max(top, 0), min(left + width, w), min(top + height, h)
    if xb > xa and yb > ya:
        out[ya - top : yb - top, xa - left : xb - left] = image[ya:yb, xa:xb]
    return out
