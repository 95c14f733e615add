"""Links between two frames: choose well-textured places, find the coarse motion, match to sub-pixel."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.matching.coarse_search import NoMatch, find_shift
from vaoi_station.stitching.matching.corner_selection import best_places
from vaoi_station.stitching.matching.evidence import Links, Task
from vaoi_station.stitching.matching.overlap import overlap_box, predict
from vaoi_station.stitching.matching.patches import fitting, match, middles
from vaoi_station.stitching.matching.prepared_frame import PreparedFrame, downsampled
from vaoi_station.stitching.matching.refinement import MARGIN_PX

_POINTS = 80
"""Places per pair of frames: enough that losing half of them to tall parts costs nothing …"""
_POINTS_APART = 40
"""… and per pair of rows that are not consecutive: they stiffen the chain."""
_GRAIN_PX, _AMPLE_PX = 8, 96
"""How finely places are chosen: a patch is three times as wide; half of it in small frames and in narrower overlaps."""
_LEAST_CELL_PX = 28
"""Places stand no closer: patches that overlap tell the same twice."""
_LEAST_SCORE = 0.80
_WORST_SIGMA_PX = 0.80
_PLACEMENT_MM = 4.0
"""How far a board may lie from where the reference lay, in the same row."""
_SLIP_SHARE, _PLAY_MM = 0.15, 1.0
"""How far the belt's motion may differ from the nominal one: a share of it, and some play."""
_MOVED_MM = 4.0
"""How far a camera that has been pushed is looked for."""
_ENOUGH = 8
"""Links between two cameras that show that both are where they were calibrated."""
_BEYOND_DOUBT = 24
"""So many are no look-alikes: those of a camera that has moved were up to eleven …"""
_MOST = 0.6
"""… nor are that share of the places that were looked for."""


def link_frames(
    task: Task, a: PreparedFrame, b: PreparedFrame, camera_a: Camera, camera_b: Camera, shift_mm: Floats
) -> Links:
    """Links between two rows of one camera, the board having moved by about `shift_mm` (2,)."""
    box = overlap_box(camera_a, camera_b, shift_mm)
    if box is None:
        return Links.empty(task, "the frames do not overlap")
    offset = _offset(box, camera_a, camera_b, shift_mm)
    reach = _PLAY_MM * camera_a.px_per_mm + _SLIP_SHARE * np.abs(offset)
    coarse = find_shift(a, b, box, offset, reach)
    if isinstance(coarse, Failure):
        return Links.empty(task, coarse.reason)
    count = _POINTS if task.b is not None and task.b[1] - task.a[1] == 1 else _POINTS_APART
    return _fine(task, a, b, camera_a, camera_b, shift_mm, box, coarse.px, count)


def link_neighbours(task: Task, a: PreparedFrame, b: PreparedFrame, camera_a: Camera, camera_b: Camera) -> Links:
    """Links between neighbouring cameras in one row; N_i alone predict them.

    Where that finds few a camera may have moved, and these be look-alikes: then the overlap is searched further, and
    links are marked `unmatched` if there is texture but little of it in both, so that the verdict can tell.
    """
    still = np.zeros(2)
    box = overlap_box(camera_a, camera_b, still)
    if box is None:
        return Links.empty(task, "the frames do not overlap")
    links = _fine(task, a, b, camera_a, camera_b, still, box, still)
    found = len(links.a_px)
    if found >= _BEYOND_DOUBT or found >= max(_ENOUGH, _MOST * links.tried):
        return links
    if _grid(a, _reduced(box, a.grey.shape, still)) is None:
        return links  # no room for a patch: that two cameras hardly overlap tells nothing of them
    coarse = find_shift(a, b, box, _offset(box, camera_a, camera_b, still), np.full(2, _MOVED_MM * camera_a.px_per_mm))
    if isinstance(coarse, Failure):
        return replace(links, unmatched=_few(links) and isinstance(coarse, NoMatch))
    moved = _fine(task, a, b, camera_a, camera_b, still, box, coarse.px)
    best = moved if len(moved.a_px) > len(links.a_px) else links
    return replace(best, unmatched=_few(best))


def _few(links: Links) -> bool:
    """Whether it is less than two cameras show that see the same; a narrow overlap has room for few places."""
    enough = _ENOUGH if links.tried >= _ENOUGH else max(_MOST * links.tried, 1)
    return len(links.a_px) < enough


def _offset(box: tuple[int, int, int, int], a: Camera, b: Camera, shift_mm: Floats) -> Floats:
    """Predicted b − a, px, in the middle of an overlap."""
    middle = np.array([[(box[0] + box[2]) / 2, (box[1] + box[3]) / 2]])
    return np.asarray((predict(middle, a, b, shift_mm) - middle)[0])


def link_reference(task: Task, a: PreparedFrame, b: PreparedFrame, camera: Camera) -> Links:
    """Links between a frame of a run and its like in the reference: the same view but for the board's place."""
    box = overlap_box(camera, camera, np.zeros(2))
    assert box is not None
    reach = np.full(2, _PLACEMENT_MM * camera.px_per_mm)
    coarse = find_shift(a, b, box, np.zeros(2), reach)
    if isinstance(coarse, Failure):
        return Links.empty(task, coarse.reason)
    return _fine(task, a, b, camera, camera, np.zeros(2), box, coarse.px)


def _fine(
    task: Task,
    a: PreparedFrame,
    b: PreparedFrame,
    camera_a: Camera,
    camera_b: Camera,
    shift_mm: Floats,
    box: tuple[int, int, int, int],
    correction_px: Floats,
    count: int = _POINTS,
) -> Links:
    """Links within an overlap, where b lies by a correction beside its prediction."""
    places = choose_places(a, _reduced(box, a.grey.shape, correction_px), count)
    guess = predict(middles(places), camera_a, camera_b, shift_mm) + correction_px
    places, guess = fitting(a.grey.shape, b.grey.shape, places, guess)
    if not len(places):
        return Links.empty(task, "no textured place in the overlap")
    m = match(a.grey, b.grey, places, guess)
    good = m.found & (m.score >= _LEAST_SCORE) & (m.sigma_px <= _WORST_SIGMA_PX)
    if not good.any():
        note = f"none of {len(places)} places was found again with correlation ≥ {_LEAST_SCORE}"
        return Links.empty(task, note, len(places))
    return Links(
        task,
        middles(places[good]),
        m.b_px[good],
        m.information[good],
        m.score[good],
        coarse_px=(float(correction_px[0]), float(correction_px[1])),
        tried=len(places),
    )


def choose_places(a: PreparedFrame, box: tuple[int, int, int, int], count: int = _POINTS) -> NDArray[np.int64]:
    """The best-textured place of each cell of a grid laid over a box of the frame, (k, 2) whole pixels."""
    grid = _grid(a, box)
    if grid is None:
        return np.zeros((0, 2), dtype=np.int64)
    grain, x0, y0, w, h = grid
    cell = max(int(math.sqrt(w * h / count)), _LEAST_CELL_PX // grain)
    nx, ny = max(round(w / cell), 1), max(round(h / cell), 1)
    best = best_places(downsampled(a, grain), x0, y0, (nx, max(w // nx, 1)), (ny, max(h // ny, 1)))
    return np.asarray(best * grain + grain // 2)


def _grid(a: PreparedFrame, box: tuple[int, int, int, int]) -> tuple[int, int, int, int, int] | None:
    """Grain in px, and x0, y0, width, height in grains, of what a box of the frame has room for; None: for no place."""
    grain = (
        _GRAIN_PX if a.factor >= _GRAIN_PX and min(box[2] - box[0], box[3] - box[1]) >= _AMPLE_PX else _GRAIN_PX // 2
    )
    x0, y0, x1, y1 = (-(-v // grain) for v in box[:2] + (box[2] - grain + 1, box[3] - grain + 1))
    return (grain, x0, y0, x1 - x0, y1 - y0) if x1 > x0 and y1 > y0 else None


def _reduced(
    box: tuple[int, int, int, int], shape: tuple[int, ...], correction_px: Floats
) -> tuple[int, int, int, int]:
    """The overlap after the coarse correction, kept off both frames' borders."""
    m = MARGIN_PX + 1
    cx, cy = correction_px
    x0, y0, x1, y1 = box[0] - min(cx, 0), box[1] - min(cy, 0), box[2] - max(cx, 0), box[3] - max(cy, 0)
    return (
        max(int(x0) + m, m),
        max(int(y0) + m, m),
        min(int(x1) - m, shape[1] - m),
        min(int(y1) - m, shape[0] - m),
    )
