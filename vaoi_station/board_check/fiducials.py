"""Whether marks are where a board type puts its fiducials."""

from __future__ import annotations

import math

import numpy as np

from vaoi_station.board_check.run_frames import CheckedRun
from vaoi_station.geometry.transforms import Floats
from vaoi_station.marks import Mark, locate_mark
from vaoi_station.model import BoardType


def distances_of_marks(run: CheckedRun, board: BoardType, tester_from_cad: Floats) -> list[float]:
    """Return for each fiducial the distance of the mark that is there from its stated place, mm; NaN for none.

    Each is searched in the frame that shows it nearest to its centre.
    """
    views = run.views(np.array([(f.x, f.y) for f in board.fiducials]).reshape(-1, 2), tester_from_cad)
    present, out = set(run.scene.present), []
    for n, fiducial in enumerate(board.fiducials):
        candidates = [
            (float(np.hypot(*(views.px[k] - run.cameras[int(views.camera[k])].center_px))), k)
            for k in np.flatnonzero(views.point == n).tolist()
            if (int(views.camera[k]), int(views.row[k])) in present
        ]
        if not candidates:
            out.append(math.nan)
            continue
        k = min(candidates)[1]
        camera, px = int(views.camera[k]), views.px[k]
        resolution = run.cameras[camera].px_per_mm
        grey = run.scene.prepared((camera, int(views.row[k]))).grey
        mark = locate_mark(grey, px, fiducial.shape, fiducial.diameter * board.mm_per_unit * resolution)
        out.append(float(np.hypot(*(mark.px - px))) / resolution if isinstance(mark, Mark) else math.nan)
    return out
