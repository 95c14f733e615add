"""Link two frames: choose well-textured corners, find the coarse shift, match patches to sub-pixel accuracy."""

from __future__ import annotations

import math
from dataclasses import dataclass, replace

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.matching.coarse_search import NoMatch, find_shift
from vaoi_station.stitching.matching.corner_selection import best_corners
from vaoi_station.stitching.matching.evidence import Links, Task
from vaoi_station.stitching.matching.overlap import Box, overlap_box, predict
from vaoi_station.stitching.matching.patches import inside_both, match_patches, patch_centres
from vaoi_station.stitching.matching.prepared_frame import PreparedFrame, downsampled
from vaoi_station.stitching.matching.refinement import MARGIN_PX

_CORNERS, _CORNERS_APART = 80, 40
"""Corners per pair of consecutive rows, enough to lose half of them to tall parts; and per pair of rows further apart,
which only stiffen the chain."""
_GRAIN_PX, _AMPLE_PX = 8, 96
"""Grid pitch of corner selection, a third of a patch; half of it in small frames and in overlaps narrower than this."""
_MIN_CELL_PX = 28
"""Least distance of corners: patches that overlap more measure the same pixels twice."""
_MIN_SCORE, _MAX_SIGMA_PX = 0.80, 0.80
"""Correlation and standard deviation of a match that becomes a link."""
_PLACEMENT_MM = 4.0
"""Range of board positions around that of the reference, in the same row."""
_SLIP_SHARE, _PLAY_MM = 0.15, 1.0
"""Range of belt motion around the nominal motion: a share of it, and a constant."""
_MOVED_MM = 4.0
"""Range in which a displaced camera is searched."""
_ENOUGH = 8
"""Links between two cameras that show that both are where they were calibrated."""
_CERTAIN, _CERTAIN_SHARE = 24, 0.6
"""A count of links, and a share of the corners, that look-alikes do not reach: a displaced camera gave up to eleven."""


@dataclass(frozen=True, eq=False)
class FramePair:
    """Two frames, their cameras, and the predicted shift of the board between them."""

    a: PreparedFrame
    b: PreparedFrame
    camera_a: Camera
    camera_b: Camera
    shift_mm: Floats
    """(2,) nominal motion of the board from frame a to frame b."""

    def overlap(self) -> Box | None:
        """Return the part of frame a that frame b shows too, if there is one."""
        return overlap_box(self.camera_a, self.camera_b, self.shift_mm)

    def predict(self, a_px: Floats) -> Floats:
        """Return the predicted points (k, 2) in frame b of points in frame a."""
        return predict(a_px, self.camera_a, self.camera_b, self.shift_mm)

    def offset_px(self, box: Box) -> Floats:
        """Return the predicted b − a (2,) in the middle of an overlap."""
        middle = np.array([[(box[0] + box[2]) / 2, (box[1] + box[3]) / 2]])
        return np.asarray((self.predict(middle) - middle)[0])


def link_rows(task: Task, pair: FramePair) -> Links:
    """Link two rows of one camera."""
    box = pair.overlap()
    if box is None:
        return Links.empty(task, "the frames do not overlap")
    offset = pair.offset_px(box)
    coarse = find_shift(pair.a, pair.b, box, offset, _PLAY_MM * pair.camera_a.px_per_mm + _SLIP_SHARE * np.abs(offset))
    if isinstance(coarse, Failure):
        return Links.empty(task, coarse.reason)
    count = _CORNERS if task.b is not None and task.b[1] - task.a[1] == 1 else _CORNERS_APART
    return _link_corners(task, pair, box, coarse.px, count)


def link_neighbours(task: Task, pair: FramePair) -> Links:
    """Link neighbouring cameras in one row, where N_i alone predict corresponding points.

    Few links can mean that a camera was displaced, and that they are look-alikes. The overlap is then searched in a
    wider range. Links are marked `unmatched` if the overlap shows texture but little of it in both frames, which the
    verdict reports.
    """
    box = pair.overlap()
    if box is None:
        return Links.empty(task, "the frames do not overlap")
    links = _link_corners(task, pair, box, np.zeros(2))
    found = len(links.a_px)
    if found >= _CERTAIN or found >= max(_ENOUGH, _CERTAIN_SHARE * links.tried):
        return links
    if _grid(pair.a, _shrink(box, pair.a.grey.shape, np.zeros(2))) is None:
        # no room for a single patch: a narrow overlap without links is no sign of a displaced camera
        return links
    reach = np.full(2, _MOVED_MM * pair.camera_a.px_per_mm)
    coarse = find_shift(pair.a, pair.b, box, pair.offset_px(box), reach)
    if isinstance(coarse, Failure):
        # an overlap without texture fails too, but only texture that does not match is a sign
        return replace(links, unmatched=_too_few(links) and isinstance(coarse, NoMatch))
    displaced = _link_corners(task, pair, box, coarse.px)
    # the more links the likelier: look-alikes rarely outnumber the true ones
    best = displaced if len(displaced.a_px) > len(links.a_px) else links
    return replace(best, unmatched=_too_few(best))


def link_reference(task: Task, pair: FramePair) -> Links:
    """Link a frame of a run and its counterpart in the reference: the same view, but for the board's position."""
    box = pair.overlap()
    assert box is not None
    reach = np.full(2, _PLACEMENT_MM * pair.camera_a.px_per_mm)
    coarse = find_shift(pair.a, pair.b, box, np.zeros(2), reach)
    if isinstance(coarse, Failure):
        return Links.empty(task, coarse.reason)
    return _link_corners(task, pair, box, coarse.px)


def _too_few(links: Links) -> bool:
    """Whether two cameras that see the same would give more links; a narrow overlap has room for few corners."""
    enough = _ENOUGH if links.tried >= _ENOUGH else max(_CERTAIN_SHARE * links.tried, 1)
    return len(links.a_px) < enough


def _link_corners(task: Task, pair: FramePair, box: Box, correction_px: Floats, count: int = _CORNERS) -> Links:
    """Match corners of an overlap in which b differs from its prediction by a correction (2,)."""
    a, b = pair.a, pair.b
    corners = choose_corners(a, _shrink(box, a.grey.shape, correction_px), count)
    guess = pair.predict(patch_centres(corners)) + correction_px
    corners, guess = inside_both(a.grey.shape, b.grey.shape, corners, guess)
    if not len(corners):
        return Links.empty(task, "no textured corner in the overlap")
    m = match_patches(a.grey, b.grey, corners, guess)
    good = m.found & (m.score >= _MIN_SCORE) & (m.sigma_px <= _MAX_SIGMA_PX)
    if not good.any():
        note = f"none of {len(corners)} corners was found again with correlation ≥ {_MIN_SCORE}"
        return Links.empty(task, note, len(corners))
    return Links(
        task,
        patch_centres(corners[good]),
        m.b_px[good],
        m.information[good],
        m.score[good],
        coarse_px=(float(correction_px[0]), float(correction_px[1])),
        tried=len(corners),
    )


def choose_corners(a: PreparedFrame, box: Box, count: int = _CORNERS) -> NDArray[np.int64]:
    """Return the best-textured corner (k, 2) of each cell of a grid over a box of the frame, in whole pixels."""
    grid = _grid(a, box)
    if grid is None:
        return np.zeros((0, 2), dtype=np.int64)
    grain, x0, y0, w, h = grid
    cell = max(int(math.sqrt(w * h / count)), _MIN_CELL_PX // grain)
    nx, ny = max(round(w / cell), 1), max(round(h / cell), 1)
    best = best_corners(downsampled(a, grain), x0, y0, (nx, max(w // nx, 1)), (ny, max(h // ny, 1)))
    return np.asarray(best * grain + grain // 2)


def _grid(a: PreparedFrame, box: Box) -> tuple[int, int, int, int, int] | None:
    """Return the grain in px, and x0, y0, width, height in grains, of the grid in a box; None if it has no room."""
    # the finer grain costs four times the pixels, which only small frames and narrow overlaps can afford
    grain = (
        _GRAIN_PX if a.factor >= _GRAIN_PX and min(box[2] - box[0], box[3] - box[1]) >= _AMPLE_PX else _GRAIN_PX // 2
    )
    x0, y0, x1, y1 = (-(-v // grain) for v in box[:2] + (box[2] - grain + 1, box[3] - grain + 1))
    return (grain, x0, y0, x1 - x0, y1 - y0) if x1 > x0 and y1 > y0 else None


def _shrink(box: Box, shape: tuple[int, ...], correction_px: Floats) -> Box:
    """Return the overlap after the coarse correction, without a margin at the borders of both frames."""
    m = MARGIN_PX + 1
    cx, cy = correction_px
    x0, y0, x1, y1 = box[0] - min(cx, 0), box[1] - min(cy, 0), box[2] - max(cx, 0), box[3] - max(cy, 0)
    return (
        max(int(x0) + m, m),
        max(int(y0) + m, m),
        min(int(x1) - m, shape[1] - m),
        min(int(y1) - m, shape[0] - m),
    )
