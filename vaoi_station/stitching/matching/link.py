"""Link two frames: find the coarse shift, choose well-textured corners, match their patches with sub-pixel accuracy."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.matching.coarse_search import NoMatch, find_shift
from vaoi_station.stitching.matching.corner_selection import best_corners
from vaoi_station.stitching.matching.evidence import Links, Task
from vaoi_station.stitching.matching.frame_pair import FramePair, in_one_exposure, in_one_grid
from vaoi_station.stitching.matching.overlap import Box
from vaoi_station.stitching.matching.patches import match_patches, patch_centres
from vaoi_station.stitching.matching.prepared_frame import PreparedFrame, downsampled
from vaoi_station.stitching.matching.refinement import MARGIN_PX

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
_COMPARED = 37
"""Every 37th line is compared first: frames that are no copies of one another differ in the first of these lines."""
_MOVED_MM = 4.0
"""Range of the coarse search between two cameras if one of them may be displaced."""
_ENOUGH = 8
"""With at least this number of links between two cameras, neither was displaced since its calibration."""
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
    """Return by how far the coarse search between two rows looks on both sides of a predicted motion.

    Both the predicted motion `shift_mm` and the returned range are (2,), mm.
    """
    return np.asarray(_PLAY_MM + _SLIP_SHARE * np.abs(shift_mm))


def are_copies(a: NDArray[np.uint8], b: NDArray[np.uint8]) -> bool:
    """Return whether two frames (h, w) are equal in every pixel. Sensor noise makes any two exposures different.

    Frames of a single grey level do not count as copies: black and saturated frames are equal without being sent twice.
    """
    if a.shape != b.shape or not np.array_equal(a[::_COMPARED], b[::_COMPARED]):
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
    reach = np.full(2, _PLACEMENT_MM * pair.camera_a.px_per_mm)
    coarse = find_shift(pair.a, pair.b, box, np.zeros(2), reach)
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
    """Choose corners in the overlap of frame a, match them in frame b, and return the good matches as links.

    Frame b is searched at the prediction plus `correction_px` (2,), the shift that the coarse search found.
    """
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
    """Return corners (k, 2), x and y in whole pixels: the best-textured place of each cell of a grid over a box.

    The grid has about `count` cells. Cells without sufficient texture have no corner.
    """
    grid = _grid(a, box)
    if grid is None:
        return np.zeros((0, 2), dtype=np.int64)
    grain, x0, y0, w, h = grid
    cell = max(int(math.sqrt(w * h / count)), _MIN_CELL_PX // grain)
    nx, ny = max(round(w / cell), 1), max(round(h / cell), 1)
    best = best_corners(downsampled(a, grain), x0, y0, (nx, max(w // nx, 1)), (ny, max(h // ny, 1)))
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
    """Return the part of the overlap in which patches can be matched.

    The correction (2,) of the coarse search reduces the overlap, and patches need a margin to the borders of both
    frames. `shape` is the shape of frame a.
    """
    m = MARGIN_PX + 1
    cx, cy = correction_px
    x0, y0, x1, y1 = box[0] - min(cx, 0), box[1] - min(cy, 0), box[2] - max(cx, 0), box[3] - max(cy, 0)
    return (
        max(int(x0) + m, m),
        max(int(y0) + m, m),
        min(int(x1) - m, shape[1] - m),
        min(int(y1) - m, shape[0] - m),
    )
