"""Whether marks are where a board type puts its fiducials."""

from __future__ import annotations

import math

import numpy as np

from vaoi_station.board_check.run_frames import CheckedRun
from vaoi_station.geometry.transforms import Floats
from vaoi_station.marks import Mark, locate_mark
from vaoi_station.model import BoardType, Fiducial


def distances_of_marks(run: CheckedRun, board: BoardType, tester_from_cad: Floats) -> list[float]:
    """Return for each fiducial the distance of the mark that is there from its stated place, mm; NaN for none.

    Each is searched in the frame that shows it nearest to its centre; if it is not found there, in the nearest frame of
    every other light, because a mark may have no contrast under one.
    """
    views = run.views(np.array([(f.x, f.y) for f in board.fiducials]).reshape(-1, 2), tester_from_cad)
    present, out = set(run.scene.present), []
    for n, fiducial in enumerate(board.fiducials):
        candidates = sorted(
            (float(np.hypot(*(views.px[k] - run.cameras[int(views.camera[k])].center_px))), k)
            for k in np.flatnonzero(views.point == n).tolist()
            if (int(views.camera[k]), int(views.row[k])) in present
        )
        nearest: dict[str, int] = {}
        for _, k in candidates:
            nearest.setdefault(run.lights[int(views.row[k])] if run.lights else "", k)
        found = (
            _distance_mm(run, fiducial, board.mm_per_unit, (int(views.camera[k]), int(views.row[k])), views.px[k])
            for k in nearest.values()
        )
        out.append(next((distance for distance in found if not math.isnan(distance)), math.nan))
    return out


def _distance_mm(run: CheckedRun, fiducial: Fiducial, mm_per_unit: float, frame: tuple[int, int], px: Floats) -> float:
    """Return how far the mark in one frame is from the pixel where it should be, mm; NaN if there is none."""
    resolution = run.cameras[frame[0]].px_per_mm
    grey = run.scene.prepared(frame).grey
    mark = locate_mark(grey, px, fiducial.shape, fiducial.diameter * mm_per_unit * resolution)
    return float(np.hypot(*(mark.px - px))) / resolution if isinstance(mark, Mark) else math.nan
