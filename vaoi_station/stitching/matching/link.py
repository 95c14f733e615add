"""Link two frames: find the coarse shift, choose well-textured corners, match their patches with sub-pixel accuracy.

The coarse search correlates the overlap in reduced, high-passed copies of the frames at all shifts within a given
range: `PreparedFrame.coarse`, called full size here, and `coarser`, of half that size.
"""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled, inlined
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.matching.evidence import Links, Task
from vaoi_station.stitching.matching.frame_pair import Box, FramePair, in_one_exposure, in_one_grid
from vaoi_station.stitching.matching.frames import PreparedFrame
from vaoi_station.stitching.matching.patches import are_inside_both, match_patches, patch_centres
from vaoi_station.stitching.matching.refinement import MARGIN_PX

Small = NDArray[np.float32]

_REACH = 2
"""Number of pixels on each side that the texture of one pixel depends on: one for the sum over 3×3, one for Sobel."""
_UNIT = 1 / (4 * 3 * 255)
"""Scale of the slopes, the same as in OpenCV's cornerMinEigenVal: 4 for Sobel, 3 for the block size, 255 grey
levels."""
_GOOD_SHARE, _WEAK, _LEAST = 0.9, 0.003, 1e-5
"""A corner is dropped as noise or belt if its texture is below `_LEAST`, or below `_WEAK` times that of a good corner.

The texture of a good corner is the quantile `_GOOD_SHARE` of the best texture of each cell."""


def best_corners(
    image: NDArray[np.uint8], x0: int, y0: int, across: tuple[int, int], down: tuple[int, int]
) -> NDArray[np.int64]:
    """Return the corners (k, 2), x and y in a reduced frame: the best pixel of each cell of a grid from (x0, y0) on.

    `across` and `down` are the number of cells and their size in pixels. Cells of weak texture have no corner.
    """
    best, at = _best_of_cells(image, x0, y0, across, down)
    # A high quantile over the cells is the texture of a good corner even if most cells show only the belt.
    least = max(_WEAK * sorted(best.tolist())[int(len(best) * _GOOD_SHARE)], _LEAST)
    return np.asarray(at[best > least])


@compiled
def _best_of_cells(
    image: NDArray[np.uint8], x0: int, y0: int, across: tuple[int, int], down: tuple[int, int]
) -> tuple[Small, NDArray[np.int64]]:
    """Return the texture of the best pixel of each cell (n,), and its x and y (n, 2).

    Texture is the smaller eigenvalue of the structure tensor (Shi and Tomasi, 1994). `cv2.cornerMinEigenVal` gives the
    same; with a selection by numpy that takes 71 µs in place of 25 µs.
    """
    nx, width = across
    ny, height = down
    columns = nx * width
    score = np.zeros((ny * height, columns), np.float32)
    _corners(image, x0, y0, score)
    best, at = np.zeros(nx * ny, np.float32), np.zeros((nx * ny, 2), np.int64)
    # Columns first, because their best values are computed in vector instructions.
    columns_best = np.empty(columns, np.float32)
    for j in range(ny):
        top = j * height
        for x in range(columns):
            columns_best[x] = score[top, x]
        for y in range(top + 1, top + height):
            for x in range(columns):
                columns_best[x] = max(columns_best[x], score[y, x])
        for i in range(nx):
            n, left = j * nx + i, i * width
            best[n], at[n, 1] = columns_best[left], y0 + top + height
            for x in range(left, left + width):
                best[n] = max(best[n], columns_best[x])
            for x in range(left, left + width):
                if columns_best[x] == best[n]:
                    y = top
                    while score[y, x] != best[n]:
                        y += 1
                    # of equal pixels the first one, line by line
                    if y0 + y < at[n, 1]:
                        at[n, 0], at[n, 1] = x0 + x, y0 + y
    return best, at


@inlined
def _corners(image: NDArray[np.uint8], x0: int, y0: int, score: Small) -> None:
    """Write the smaller eigenvalue of the structure tensor to `score` (H, W), for the image pixels from (x0, y0) on.

    Pixels within `_REACH` of the image's border keep the value 0.
    """
    rows, columns = score.shape
    h, w = image.shape
    left, top = max(x0, _REACH), max(y0, _REACH)
    right, bottom = min(x0 + columns, w - _REACH), min(y0 + rows, h - _REACH)
    # slopes are needed one pixel further on every side, for the sums over 3×3
    wide, high = right - left + 2, bottom - top + 2
    if wide <= 2 or high <= 2:
        return
    gx, gy = np.empty(wide * high, np.float32), np.empty(wide * high, np.float32)
    unit = np.float32(_UNIT)
    for y in range(high):
        above, here, below = image[top - 2 + y], image[top - 1 + y], image[top + y]
        a, b, c = above[left - 2 : right + 2], here[left - 2 : right + 2], below[left - 2 : right + 2]
        to_x, to_y = gx[y * wide : (y + 1) * wide], gy[y * wide : (y + 1) * wide]
        for x in range(wide):
            before, after = a[x] + 2 * b[x] + c[x], a[x + 2] + 2 * b[x + 2] + c[x + 2]
            over, under = a[x] + 2 * a[x + 1] + a[x + 2], c[x] + 2 * c[x + 1] + c[x + 2]
            to_x[x], to_y[x] = unit * np.int32(after - before), unit * np.int32(under - over)
    size = wide * (high - 2)
    xx, xy, yy = np.empty(size, np.float32), np.empty(size, np.float32), np.empty(size, np.float32)
    for n in range(size):
        u0, u1, u2 = gx[n], gx[n + wide], gx[n + 2 * wide]
        v0, v1, v2 = gy[n], gy[n + wide], gy[n + 2 * wide]
        xx[n], xy[n], yy[n] = u0 * u0 + u1 * u1 + u2 * u2, u0 * v0 + u1 * v1 + u2 * v2, v0 * v0 + v1 * v1 + v2 * v2
    half = np.float32(0.5)
    for y in range(high - 2):
        f, g, k = xx[y * wide : (y + 1) * wide], xy[y * wide : (y + 1) * wide], yy[y * wide : (y + 1) * wide]
        to = score[top - y0 + y, left - x0 : right - x0]
        for x in range(wide - 2):
            p, q, r = f[x] + f[x + 1] + f[x + 2], g[x] + g[x + 1] + g[x + 2], k[x] + k[x + 1] + k[x + 2]
            to[x] = half * (p + r) - math.sqrt(half * half * (p - r) * (p - r) + q * q)


_LEAST_SHIFT_SCORE = 0.25  # smallest correlation with which a shift is reported
_WIDE_PX = 24
"""Width of an overlap, in pixels of half size, from which on it is searched at half size only.

There it has a quarter of the pixels and a quarter of the shifts. An overlap of at least half this width is searched at
half size first."""
_PEAKS, _RIVAL, _AROUND_PX = 4, 0.8, 2
"""Which peaks of the search at half size are searched again at full size.

At most `_PEAKS`, with at least the share `_RIVAL` of the highest correlation, each within ±`_AROUND_PX` pixels."""
_SIMILAR = 0.75  # another shift is reported as a rival if its correlation is at least this share of the highest one
_DISTINCT_PX = 3
"""Least distance of a rival from the best shift, in pixels of the searched copy: closer peaks are the same peak."""
_DIRECT = 1_200_000
"""Largest number of products for which a correlation is summed directly. Beyond it, OpenCV's Fourier transform is
faster."""
_MIN_CONTRAST = 1.0  # contrast, rms of the high-passed grey levels, below which an overlap counts as empty


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
    """Find by how much the content of frame a, inside the overlap `box`, is shifted in frame b beyond the prediction.

    Args:
        offset_px: (2,) predicted position in frame b minus position in frame a, in the middle of the overlap.
        reach_px: (2,) the search covers shifts within ± this range around `offset_px`.
    """
    narrow = min(box[2] - box[0], box[3] - box[1])
    wide = narrow >= _WIDE_PX * 2 * a.factor
    f, coarse_a, coarse_b = (2 * a.factor, a.coarser, b.coarser) if wide else (a.factor, a.coarse, b.coarse)
    template = _cut(coarse_a, box, f)
    if min(template.shape, default=0) < 4:
        return Failure(f"the overlap of {box[2] - box[0]}×{box[3] - box[1]} px is too narrow to search in")
    template = np.ascontiguousarray(template)
    # The search divides by the contrast: in an empty overlap, noise could reach any correlation.
    contrast = math.sqrt(float(np.vdot(template, template)) / template.size)
    if contrast < _MIN_CONTRAST:
        return Failure(f"the overlap is empty: contrast {contrast:.1f} grey levels")
    # An overlap narrower than _WIDE_PX / 2 at half size has no reliable peak there: it is searched at full size at
    # once.
    if wide or narrow < _WIDE_PX * a.factor:
        peaks = _peaks(template, coarse_b, box, f, offset_px, reach_px, 2)
    else:
        around = np.full(2, float(_AROUND_PX * f))
        first = _peaks(_cut(a.coarser, box, 2 * f), b.coarser, box, 2 * f, offset_px, reach_px, _PEAKS)
        rivals = [shift * 2 * f for score, shift in first if score >= _RIVAL * first[0][0]]
        found = [_peaks(template, coarse_b, box, f, shift_px, around, 1) for shift_px in rivals or [offset_px]]
        peaks = sorted((peak for one in found for peak in one), key=lambda peak: -peak[0])
    score, shift = peaks[0]
    if score < _LEAST_SHIFT_SCORE:
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
    """Correlate a template with a reduced frame b around the predicted shift and return at most `most` peaks.

    `factor` is the size of a reduced pixel. Each peak is its correlation and its shift (2,) in reduced pixels, the
    highest first; box, offset and reach are in pixels of the frames.
    """
    # One pixel more on every side, because the parabola through a peak needs the neighbours of the peak.
    reach_x, reach_y = (max(math.ceil(v / factor) + 1, 2) for v in reach_px.tolist())
    shift_x, shift_y = (round(v / factor) for v in offset_px.tolist())
    left, top = round(box[0] / factor) + shift_x - reach_x, round(box[1] / factor) + shift_y - reach_y
    # Pixels of the window outside the image are 0, that is no texture.
    window = np.zeros((template.shape[0] + 2 * reach_y, template.shape[1] + 2 * reach_x), dtype=np.float32)
    (height, width), (h, w) = window.shape, image.shape
    xa, ya, xb, yb = max(left, 0), max(top, 0), min(left + width, w), min(top + height, h)
    if xb > xa and yb > ya:
        window[ya - top : yb - top, xa - left : xb - left] = image[ya:yb, xa:xb]
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
    """Return the correlation of a template (h, w) with a window (H, W) at every shift, (H − h + 1, W − w + 1).

    Template and window are high-passed, so that means need not be subtracted. It is 0 where the window is empty.
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


_CORNERS, _CORNERS_APART = 80, 40
"""Number of corners per pair of frames.

`_CORNERS` is enough even if half of them are lost to tall components. `_CORNERS_APART` is for rows that are not
consecutive; their links only improve the shape of the chain of rows."""
_GRAIN_PX, _AMPLE_PX = 8, 96
"""Corners are selected in copies that are reduced by `_GRAIN_PX`, a third of a patch.

Small frames, and overlaps narrower than `_AMPLE_PX`, are reduced by half of it."""
_MIN_CELL_PX = 28
"""Smallest side of a cell of the corner grid, px. With smaller cells, two patches would measure the same pixels."""
_MIN_SCORE, _MAX_SIGMA_PX = 0.80, 0.80
"""Smallest correlation, and largest standard deviation, of a match that becomes a link."""
_PLACEMENT_MM = 4.0
"""Range of the coarse search between run and reference, mm: the board's position in a row may differ by this."""
_SLIP_SHARE, _PLAY_MM = 0.15, 1.0
"""Range of the coarse search between rows: the share `_SLIP_SHARE` of the nominal motion, plus `_PLAY_MM`."""
_MOVED_MM = 4.0  # range of the coarse search between two cameras if one of them may be displaced
_ENOUGH = 8  # with at least this number of links between two cameras, neither was displaced since its calibration
_CERTAIN, _CERTAIN_SHARE = 24, 0.6
"""Number of links, and share of the tried corners, that only correct links reach.

With false links to similar texture, a displaced camera gave at most eleven links."""


def link_rows(task: Task, pair: FramePair) -> Links:
    """Link two frames of one camera in different rows, with a coarse search around the nominal belt motion.

    Two frames that are equal in every pixel have no links, and `Links.copied` is set.
    """
    box = pair.overlap()
    if box is None:
        return Links.empty(task, "the frames do not overlap")
    if are_copies(pair.a.grey, pair.b.grey):
        return replace(Links.empty(task, "the second frame is a copy of the first"), copied=True)
    offset = pair.offset_px(box)
    coarse = find_shift(pair.a, pair.b, box, offset, _PLAY_MM * pair.camera_a.px_per_mm + _SLIP_SHARE * np.abs(offset))
    if isinstance(coarse, Failure):
        return Links.empty(task, coarse.reason)
    pair = in_one_exposure(pair, box, coarse.px)
    count = _CORNERS if task.b is not None and task.b[1] - task.a[1] == 1 else _CORNERS_APART
    links = _link_corners(task, pair, box, coarse.px, count)
    rival = coarse.rival_px
    return links if rival is None else replace(links, rival_px=(float(rival[0]), float(rival[1])))


def row_reach_mm(shift_mm: Floats) -> Floats:
    """Return by how far (2,) mm the coarse search between two rows looks on both sides of a predicted motion (2,)."""
    return np.asarray(_PLAY_MM + _SLIP_SHARE * np.abs(shift_mm))


def are_copies(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> bool:
    """Return whether two frames (h, w) are equal in every pixel. Sensor noise makes any two exposures different.

    Frames of a single grey level do not count as copies: black and saturated frames are equal without being sent twice.
    """
    middle = len(a) // 2
    if a.shape != b.shape or not np.array_equal(a[middle], b[middle]):
        return False
    return bool(np.array_equal(a, b) and np.ptp(a) > 0)


def link_neighbours(task: Task, pair: FramePair) -> Links:
    """Link the frames of two neighbouring cameras in one row, where the camera matrices N_i predict the correspondence.

    If only few links are found, a camera may have been displaced and the links may be false. A coarse search in a wider
    range then looks for the true correspondence. `Links.unmatched` is set if the overlap shows texture of which hardly
    any was found in both frames; the verdict reports this.
    """
    pair = in_one_grid(pair)
    box = pair.overlap()
    if box is None:
        return Links.empty(task, "the frames do not overlap")
    pair = in_one_exposure(pair, box, np.zeros(2))
    links = _link_corners(task, pair, box, np.zeros(2))
    found = len(links.a_px)
    if found >= _CERTAIN or found >= max(_ENOUGH, _CERTAIN_SHARE * links.tried):
        return links
    if not pair.room or _grid(pair.a, _shrink(box, pair.a.grey.shape, np.zeros(2))) is None:
        # The overlap is too small for a patch. That it has no links is then no sign of a displaced camera.
        return links
    reach = np.full(2, _MOVED_MM * pair.px_per_mm)
    pair = pair.reaching(float(reach[0]))
    coarse = find_shift(pair.a, pair.b, box, pair.offset_px(box), reach)
    if isinstance(coarse, Failure):
        # The search also fails without texture. Only texture that does not match is a sign of a displaced camera.
        return replace(links, unmatched=_too_few(links) and isinstance(coarse, NoMatch))
    displaced = _link_corners(task, pair, box, coarse.px)
    # The larger set of links is more likely to be correct: false links rarely outnumber correct ones.
    best = displaced if len(displaced.a_px) > len(links.a_px) else links
    return replace(best, unmatched=_too_few(best))


def link_in_place(task: Task, pair: FramePair) -> Links:
    """Link two frames at the place that the cameras predict, without a search for a displacement."""
    pair = in_one_grid(pair)
    box = pair.overlap()
    if box is None:
        return Links.empty(task, "the frames do not overlap")
    return _link_corners(task, pair, box, np.zeros(2))


def link_reference(task: Task, pair: FramePair) -> Links:
    """Link a frame of a run to the frame of the reference with the same camera and row.

    Only the position of the board differs between the two frames.
    """
    box = pair.overlap()
    assert box is not None
    coarse = find_shift(pair.a, pair.b, box, np.zeros(2), np.full(2, _PLACEMENT_MM * pair.camera_a.px_per_mm))
    if isinstance(coarse, Failure):
        return Links.empty(task, coarse.reason)
    return _link_corners(task, pair, box, coarse.px)


def _too_few(links: Links) -> bool:
    """Whether there are fewer links than between two cameras that have not moved since their calibration.

    In a narrow overlap with few corners, the limit is a share of these corners.
    """
    enough = _ENOUGH if links.tried >= _ENOUGH else max(_CERTAIN_SHARE * links.tried, 1)
    return len(links.a_px) < enough


def _link_corners(task: Task, pair: FramePair, box: Box, correction_px: Floats, count: int = _CORNERS) -> Links:
    """Choose corners in the overlap of frame a, match them in frame b at the prediction plus `correction_px` (2,)."""
    a, b = pair.a, pair.b
    corners = choose_corners(a, _shrink(box, a.grey.shape, correction_px), round(count * pair.spread))
    guess = pair.predict(patch_centres(corners)) + correction_px
    corners, guess = pair.inside(corners, guess)
    if not len(corners):
        return Links.empty(task, "no textured corner in the overlap")
    m = match_patches(a.grey, b.grey, corners, guess)
    good = m.found & (m.score >= _MIN_SCORE) & (m.sigma_px <= _MAX_SIGMA_PX)
    if not good.any():
        note = f"none of {len(corners)} corners was found again with correlation ≥ {_MIN_SCORE}"
        return Links.empty(task, note, len(corners))
    coarse_px = (float(correction_px[0]), float(correction_px[1]))
    found = patch_centres(corners[good]), m.b_px[good], m.information[good], m.score[good]
    return pair.in_frames(Links(task, *found, coarse_px=coarse_px, tried=len(corners)))


def choose_corners(a: PreparedFrame, box: Box, count: int = _CORNERS) -> NDArray[np.int64]:
    """Return corners (k, 2), x and y in whole pixels: the best-textured places of about `count` cells of a box."""
    grid = _grid(a, box)
    if grid is None:
        return np.zeros((0, 2), dtype=np.int64)
    grain, x0, y0, w, h = grid
    cell = max(int(math.sqrt(w * h / count)), _MIN_CELL_PX // grain)
    nx, ny = max(round(w / cell), 1), max(round(h / cell), 1)
    best = best_corners(a.reduced(grain), x0, y0, (nx, max(w // nx, 1)), (ny, max(h // ny, 1)))
    return np.asarray(best * grain + grain // 2)


def _grid(a: PreparedFrame, box: Box) -> tuple[int, int, int, int, int] | None:
    """Return the grid of corner selection in a box: (grain, x0, y0, width, height), or None if the box is too small.

    The grain is the reduction of the copy in which corners are selected, in px; the other values are in grains.
    """
    # half the grain means four times as many pixels: acceptable only in small frames and narrow overlaps
    grain = (
        _GRAIN_PX if a.factor >= _GRAIN_PX and min(box[2] - box[0], box[3] - box[1]) >= _AMPLE_PX else _GRAIN_PX // 2
    )
    x0, y0, x1, y1 = (-(-v // grain) for v in box[:2] + (box[2] - grain + 1, box[3] - grain + 1))
    return (grain, x0, y0, x1 - x0, y1 - y0) if x1 > x0 and y1 > y0 else None


def _shrink(box: Box, shape: tuple[int, ...], correction_px: Floats) -> Box:
    """Return the part of the overlap in which patches can be matched, for the shape of frame a.

    The correction (2,) of the coarse search reduces the overlap, and patches need a margin to the borders.
    """
    m = MARGIN_PX + 1
    cx, cy = correction_px
    x0, y0 = max(int(box[0] - min(cx, 0)) + m, m), max(int(box[1] - min(cy, 0)) + m, m)
    return x0, y0, min(int(box[2] - max(cx, 0)) - m, shape[1] - m), min(int(box[3] - max(cy, 0)) - m, shape[0] - m)


STATIC_PX = 1.5  # largest distance in px between two places that count as the same: noise, and vibration of the cameras
_SAME_SCORE = 0.8  # least correlation of two patches that show the same texture


def shows_patches(
    a: np.ndarray, b: np.ndarray, a_px: Floats, b_px: Floats, within_px: float
) -> tuple[np.ndarray, np.ndarray]:
    """Return (k,) whether image b shows the patches of image a, centred at a_px (k, 2), near b_px (k, 2).

    The second returned value is (k,) whether the place lies inside image b, so that the patch could be found.
    """
    corners = np.rint(a_px - 0.5).astype(np.int64)
    guess = patch_centres(corners) + b_px - a_px
    tested = are_inside_both(a.shape, b.shape, corners, guess)
    shown = tested.copy()
    if tested.any():
        m = match_patches(a, b, corners[tested], guess[tested])
        shown[tested] = m.found & (m.score >= _SAME_SCORE) & (np.hypot(*(m.b_px - guess[tested]).T) <= within_px)
    return shown, tested


def static_corners(pair: FramePair) -> int:
    """Return how many corners in the overlap of two frames appear in the same place in both frames."""
    box = pair.overlap()
    if box is None:
        return 0
    px = patch_centres(choose_corners(pair.a, box))
    return int(shows_patches(pair.a.grey, pair.b.grey, px, px, STATIC_PX)[0].sum()) if len(px) else 0
