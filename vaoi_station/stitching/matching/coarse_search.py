"""Coarse search: the difference of the real motion from the nominal one, to a pixel or two.

The overlap, small and high-passed, is correlated within the range of the belt's motion. A wide overlap is correlated at
half the size only. A narrower one is correlated at half the size first, which limits the search at full size to a few
peaks.
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

_MIN_SCORE = 0.25
"""Correlation below which no shift is reported."""
_AMPLE_PX = 24
"""Width of an overlap at half the size from which it is searched there only, at a quarter of the pixels and of
the shifts; from half that width on it is searched there first."""
_PEAKS, _RIVAL, _AROUND_PX = 4, 0.8, 2
"""Peaks at half the size that are searched at full size: their number, their least share of the highest, and the range
around them."""
_DIRECT = 1_200_000
"""Products up to which a correlation is summed directly; beyond, OpenCV's Fourier transform is faster."""
_MIN_CONTRAST = 1.0
"""Grey levels (rms) of texture below which an overlap counts as empty."""

Small = NDArray[np.float32]


@dataclass(frozen=True)
class CoarseShift:
    """The shift to add to the nominal prediction, in pixels of frame b, and its correlation."""

    px: Floats
    score: float


class NoMatch(Failure):
    """The overlap has texture, but the other frame does not show it."""


def find_shift(
    a: PreparedFrame, b: PreparedFrame, box: tuple[int, int, int, int], offset_px: Floats, reach_px: Floats
) -> CoarseShift | Failure:
    """Find the shift of frame a's content in frame b beyond the prediction.

    Args:
        a: frame whose overlap is the template.
        b: frame that is searched.
        box: the overlap in frame a, x0, y0, x1, y1.
        offset_px: (2,) predicted b − a in the middle of the overlap.
        reach_px: (2,) range of the search around it.
    """
    narrow = min(box[2] - box[0], box[3] - box[1])
    wide = narrow >= _AMPLE_PX * 2 * a.factor
    f, coarse_a, coarse_b = (2 * a.factor, a.coarser, b.coarser) if wide else (a.factor, a.coarse, b.coarse)
    template = _cut(coarse_a, box, f)
    if min(template.shape, default=0) < 4:
        return Failure(f"the overlap of {box[2] - box[0]}×{box[3] - box[1]} px is too narrow to search in")
    template = np.ascontiguousarray(template)
    # normalised correlation magnifies the noise of an empty overlap to any score
    contrast = math.sqrt(float(np.vdot(template, template)) / template.size)
    if contrast < _MIN_CONTRAST:
        return Failure(f"the overlap is empty: contrast {contrast:.1f} grey levels")
    # an overlap that half the size would leave narrower than half of _AMPLE_PX has no reliable peak there
    if wide or narrow < _AMPLE_PX * a.factor:
        peaks = _peaks(template, coarse_b, box, f, offset_px, reach_px, 1)
    else:
        around = np.full(2, float(_AROUND_PX * f))
        first = _peaks(_cut(a.coarser, box, 2 * f), b.coarser, box, 2 * f, offset_px, reach_px, _PEAKS)
        rivals = [shift * 2 * f for score, shift in first if score >= _RIVAL * first[0][0]]
        found = [_peaks(template, coarse_b, box, f, shift_px, around, 1) for shift_px in rivals or [offset_px]]
        peaks = sorted((peak for one in found for peak in one), key=lambda peak: -peak[0])
    score, shift = peaks[0]
    if score < _MIN_SCORE:
        return NoMatch(f"no place within ±{reach_px[0]:.0f}, ±{reach_px[1]:.0f} px fits: best correlation {score:.2f}")
    return CoarseShift(shift * f - offset_px, score)


def _cut(coarse: Small, box: tuple[int, int, int, int], factor: int) -> Small:
    """Return the part of a reduced frame that shows a box of the frame."""
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
    """Return the best correlations and their shifts (2,) in pixels of the image, the best first."""
    # one more on every side: the parabola through a peak needs its neighbours
    reach_x, reach_y = (max(math.ceil(v / factor) + 1, 2) for v in reach_px.tolist())
    shift_x, shift_y = (round(v / factor) for v in offset_px.tolist())
    left, top = round(box[0] / factor) + shift_x - reach_x, round(box[1] / factor) + shift_y - reach_y
    window = _window(image, left, top, template.shape[1] + 2 * reach_x, template.shape[0] + 2 * reach_y)
    if template.size * (2 * reach_x + 1) * (2 * reach_y + 1) <= _DIRECT:
        surface = correlations(np.ascontiguousarray(template), window)
    else:
        surface = cv2.matchTemplate(window, template, cv2.TM_CCORR_NORMED)
        # where the window is empty OpenCV divides by zero
        surface = np.nan_to_num(surface, nan=0.0, posinf=0.0, neginf=0.0)
    return [
        (score, np.array([x - reach_x + shift_x, y - reach_y + shift_y]))
        for score, x, y in best_peaks(np.ascontiguousarray(surface), most).tolist()
    ]


@compiled
def correlations(template: Small, window: Small) -> Small:
    """Correlate a template (h, w) with a window at every shift, normalised, without subtracting means (both have none).

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
    # template and window have the same pitch in memory, so that one flat loop, which vectorises, is a correlation
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
    """Return the highest maxima (k, 3) of a surface: height, and x and y by parabolas through the neighbours."""
    rows, columns = surface.shape
    found, count = np.zeros((most, 3)), 0
    for y in range(rows):
        for x in range(columns):
            height = surface[y, x]
            at = count
            while at > 0 and height > found[at - 1, 0]:
                at -= 1
            if at == most or not _is_peak(surface, x, y):
                continue
            count = min(count + 1, most)
            for k in range(count - 1, at, -1):
                found[k] = found[k - 1]
            found[at, 0] = height
            found[at, 1], found[at, 2] = x + _vertex_offset(surface[y], x), y + _vertex_offset(surface[:, x], y)
    return found[:count]


@inlined
def _is_peak(surface: Small, x: int, y: int) -> bool:
    """Whether a sample is above all its neighbours; of equal ones the first counts."""
    rows, columns = surface.shape
    for i in range(max(y - 1, 0), min(y + 2, rows)):
        for j in range(max(x - 1, 0), min(x + 2, columns)):
            earlier = i < y or (i == y and j < x)
            if surface[i, j] > surface[y, x] or (earlier and surface[i, j] == surface[y, x]):
                return False
    return True


@inlined
def _vertex_offset(line: Small, k: int) -> float:
    """Return the offset of the maximum from sample k, by a parabola through its neighbours."""
    if not 0 < k < len(line) - 1:
        return 0.0
    bend = line[k - 1] - 2 * line[k] + line[k + 1]
    return 0.5 * (line[k - 1] - line[k + 1]) / bend if bend < 0 else 0.0


def _window(image: Small, left: int, top: int, width: int, height: int) -> Small:
    """Return a part of an image, with zeros (no texture) outside."""
    h, w = image.shape
    out = np.zeros((height, width), dtype=np.float32)
    xa, ya, xb, yb = max(left, 0), max(top, 0), min(left + width, w), min(top + height, h)
    if xb > xa and yb > ya:
        out[ya - top : yb - top, xa - left : xb - left] = image[ya:yb, xa:xb]
    return out
