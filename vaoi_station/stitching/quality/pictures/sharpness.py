"""Blur of the cameras' pictures, measured at the edges of fiducials.

In blurred pictures the patches of corners near the board's edge show the edge and what lies beyond it, and a last row
that few corners place is off by up to 1.5 px (seed 111791), beyond its σ. Such pictures serve no inspection either.
"""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vaoi_station.marks.blur import BLUR_LIMIT_PX, measure_blur_px
from vaoi_station.model import Reason, ReasonCode
from vaoi_station.stitching.adjustment.problem import FiducialPoints
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.matching.scene import Scene


def camera_blurs(plane: BoardPlane, scene: Scene, points: FiducialPoints) -> dict[int, float]:
    """Return for each camera that shows a fiducial the blur of the sharpest one, px (standard deviation of an edge).

    Args:
        plane: plane of the board type.
        scene: the cameras and frames.
        points: the observed points, of which the detections of fiducials are used.
    """
    blurs = dict[int, float]()
    board = plane.board_type
    for n in np.flatnonzero(points.which >= 0).tolist():
        key = (int(points.camera[n]), int(points.row[n]))
        camera = scene.cameras[key[0]]
        size_px = board.fiducials[points.which[n]].diameter * board.mm_per_unit * camera.px_per_mm
        blur = measure_blur_px(scene.prepared(key).grey, camera.project(points.ground_mm[n : n + 1]), size_px)
        blurs[key[0]] = min(blur, blurs.get(key[0], np.inf))
    return blurs


def blur_reasons(blurs: Mapping[int, float]) -> list[Reason]:
    """Return a reason that names the cameras whose pictures are blurred beyond the limit."""
    blurred = {camera: px for camera, px in sorted(blurs.items()) if px > BLUR_LIMIT_PX}
    if not blurred:
        return []
    which = ", ".join(f"camera {camera} by {px:.1f} px" for camera, px in blurred.items())
    return [
        Reason(
            ReasonCode.PICTURES_BLURRED,
            f"pictures are blurred at the edges of fiducials: {which} (standard deviation, limit {BLUR_LIMIT_PX} px); "
            "focus the lens, lay the board at the height for which it was focused, or film it with a shorter exposure",
        )
    ]
