"""Coarse search: estimate, to a pixel or two, by how much the shift between two frames differs from the prediction.

The overlap is cut from reduced, high-passed copies of the frames and correlated at all shifts within a given range.
`PreparedFrame` has two such copies: `coarse`, called full size here, and `coarser`, of half that size. A wide overlap
is searched at half size only. A narrower one is searched at half size first; the search at full size is then limited to
the surroundings of a few peaks.
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
"""Smallest correlation with which a shift is reported."""
_AMPLE_PX = 24
"""Width of an overlap, in pixels of half size, from which on it is searched at half size only.

There it has a quarter of the pixels and a quarter of the shifts. An overlap of at least half this width is searched at
half size first."""
_PEAKS, _RIVAL, _AROUND_PX = 4, 0.8, 2
"""Which peaks of the search at half size are searched again at full size.

At most `_PEAKS`, with at least the share `_RIVAL` of the highest correlation, each within ±`_AROUND_PX` pixels."""
_SIMILAR = 0.75
"""Another shift is reported as a rival if its correlation is at least this share of the highest one."""
_DISTINCT_PX = 3
"""Least distance of a rival from the best shift, in pixels of the searched copy: closer peaks are the same peak."""
_DIRECT = 1_200_000
"""Largest number of products for which a correlation is summed directly. Beyond it, OpenCV's Fourier transform is
faster."""
_MIN_CONTRAST = 1.0
"""Contrast, rms of the high-passed grey levels, below which an overlap counts as empty."""

Small = NDArray[np.float32]


@dataclass(frozen=True)
class CoarseShift:
    """The estimate of a coarse search: the shift (2,) to add to the prediction, in px, and its correlation."""

    px: Floats
    score: float
    rival_px: Floats | None = None
    """The shift (2,) that fits second best, if its correlation is at least the share `_SIMILAR`; else None."""


class NoMatch(Failure):
    """The failure of a search where the overlap of frame a has texture that was not found in frame b."""


def find_shift(
    a: PreparedFrame, b: PreparedFrame, box: tuple[int, int, int, int], offset_px: Floats, reach_px: Floats
) -> CoarseShift | Failure:
    """Find by how much the content of frame a is shifted in frame b beyond the prediction.

    Args:
        a: the frame whose part inside the overlap is the template.
        b: the frame in which the template is searched.
        box: the overlap (x0, y0, x1, y1) in pixels of frame a.
        offset_px: (2,) predicted position in frame b minus position in frame a, in the middle of the overlap.
        reach_px: (2,) the search covers shifts within ± this range around `offset_px`.
    """
    narrow = min(box[2] - box[0], box[3] - box[1])
    wide = narrow >= _AMPLE_PX * 2 * a.factor
    f, coarse_a, coarse_b = (2 * a.factor, a.coarser, b.coarser) if wide else (a.factor, a.coarse, b.coarse)
    template = _cut(coarse_a, box, f)
    if min(template.shape, default=0) < 4:
        return Failure(f"the overlap of {box[2] - box[0]}×{box[3] - box[1]} px is too narrow to search in")
    template = np.ascontiguousarray(template)
    # The search divides by the contrast: in an empty overlap, noise could reach any correlation.
    contrast = math.sqrt(float(np.vdot(template, template)) / template.size)
    if contrast < _MIN_CONTRAST:
        return Failure(f"the overlap is empty: contrast {contrast:.1f} grey levels")
    # An overlap narrower than _AMPLE_PX / 2 at half size has no reliable peak there: it is searched at full size at
    # once.
    if wide or narrow < _AMPLE_PX * a.factor:
        peaks = _peaks(template, coarse_b, box, f, offset_px, reach_px, 2)
    else:
        around = np.full(2, float(_AROUND_PX * f))
        first = _peaks(_cut(a.coarser, box, 2 * f), b.coarser, box, 2 * f, offset_px, reach_px, _PEAKS)
        rivals = [shift * 2 * f for score, shift in first if score >= _RIVAL * first[0][0]]
        found = [_peaks(template, coarse_b, box, f, shift_px, around, 1) for shift_px in rivals or [offset_px]]
        peaks = sorted((peak for one in found for peak in one), key=lambda peak: -peak[0])
    score, shift = peaks[0]
    if score < _MIN_SCORE:
        return NoMatch(f"no place within ±{reach_px[0]:.0f}, ±{reach_px[1]:.0f} px fits: best correlation {score:.2f}")
    others = (at * f for other, at in peaks[1:] if other >= _SIMILAR * score)
    rival = next((at - offset_px for at in others if np.hypot(*(at - shift * f)) > _DISTINCT_PX * f), None)
    return CoarseShift(shift * f - offset_px, score, rival)


def _cut(coarse: Small, box: tuple[int, int, int, int], factor: int) -> Small:
    """Return the part of a reduced copy (`factor` times smaller) that shows the box (x0, y0, x1, y1) of the frame."""
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
    """Correlate a template with a reduced frame around the predicted shift and return the highest peaks.

    Args:
        template: the overlap, cut from the reduced frame a.
        image: the reduced frame b.
        box: the overlap in pixels of the unreduced frame a.
        factor: the size of a pixel of `image` in pixels of the frame.
        offset_px: (2,) predicted shift in pixels of the frame.
        reach_px: (2,) range of the search in pixels of the frame.
        most: largest number of peaks.

    Returns:
        Correlation and shift (2,) of each peak, the highest first; shifts are in pixels of `image`.
    """
    # One pixel more on every side, because the parabola through a peak needs the neighbours of the peak.
    reach_x, reach_y = (max(math.ceil(v / factor) + 1, 2) for v in reach_px.tolist())
    shift_x, shift_y = (round(v / factor) for v in offset_px.tolist())
    left, top = round(box[0] / factor) + shift_x - reach_x, round(box[1] / factor) + shift_y - reach_y
    window = _window(image, left, top, template.shape[1] + 2 * reach_x, template.shape[0] + 2 * reach_y)
    if template.size * (2 * reach_x + 1) * (2 * reach_y + 1) <= _DIRECT:
        surface = correlations(np.ascontiguousarray(template), window)
    else:
        surface = cv2.matchTemplate(window, template, cv2.TM_CCORR_NORMED)
        # OpenCV divides by zero where the window is empty
        surface = np.nan_to_num(surface, nan=0.0, posinf=0.0, neginf=0.0)
    return [
        (score, np.array([x - reach_x + shift_x, y - reach_y + shift_y]))
        for score, x, y in best_peaks(np.ascontiguousarray(surface), most).tolist()
    ]


@compiled
def correlations(template: Small, window: Small) -> Small:
    """Return the normalised correlation of a template (h, w) with a window (H, W) at every shift.

    Template and window are high-passed, so that means need not be subtracted.

    Returns:
        (H − h + 1, W − w + 1) correlations; 0 at shifts where the window is empty.
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
    # The template is stored with the line pitch of the window, so that the sum over both dimensions is one flat loop,
    # which the compiler turns into vector instructions.
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
    """Return the k highest local maxima (k, 3) of a correlation surface, k ≤ `most`, the highest first.

    Each is the correlation and the position x, y, interpolated by parabolas through the neighbouring samples.
    """
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
                found[k, 0], found[k, 1], found[k, 2] = found[k - 1, 0], found[k - 1, 1], found[k - 1, 2]
            found[at, 0] = height
            found[at, 1], found[at, 2] = x + _vertex_offset(surface[y], x), y + _vertex_offset(surface[:, x], y)
    return found[:count]


@inlined
def _is_peak(surface: Small, x: int, y: int) -> bool:
    """Whether the sample (x, y) is higher than its eight neighbours. Among equal samples, the first one is the peak."""
    rows, columns = surface.shape
    for i in range(max(y - 1, 0), min(y + 2, rows)):
        for j in range(max(x - 1, 0), min(x + 2, columns)):
            earlier = i < y or (i == y and j < x)
            if surface[i, j] > surface[y, x] or (earlier and surface[i, j] == surface[y, x]):
                return False
    return True


@inlined
def _vertex_offset(line: Small, k: int) -> float:
    """Return the position of the maximum relative to sample k, from a parabola through it and its two neighbours."""
    if not 0 < k < len(line) - 1:
        return 0.0
    bend = line[k - 1] - 2 * line[k] + line[k + 1]
    return 0.5 * (line[k - 1] - line[k + 1]) / bend if bend < 0 else 0.0


def _window(image: Small, left: int, top: int, width: int, height: int) -> Small:
    """Cut a window out of a high-passed image; pixels of the window outside the image are 0, that is no texture."""
    h, w = image.shape
    out = np.zeros((height, width), dtype=np.float32)
    xa, ya, xb, yb = max(left, 0), max(top, 0), min(left + width, w), min(top + height, h)
    if xb > xa and yb > ya:
        out[ya - top : yb - top, xa - left : xb - left] = image[ya:yb, xa:xb]
    return out
