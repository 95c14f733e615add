"""Search for fiducials of another size: check whether the board type states a wrong diameter.

The search for fiducials finds only marks of about the stated size. If no board was found, the frames are searched once
more for marks of other sizes. If such marks lie at the distances of the fiducials, and the outline of the board is
visible where these marks put it, the diameter in the board type is wrong.
"""

from __future__ import annotations

import numpy as np

from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Reason, ReasonCode
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.board.board_plane import board_plane, expected_angle, typical_camera
from vaoi_station.stitching.board.expectation import Expectation
from vaoi_station.stitching.board.fiducial_assignment import find_board, merge_detections
from vaoi_station.stitching.board.fiducial_detection import detect_marks
from vaoi_station.stitching.board.orientation import measure_outline_contrast
from vaoi_station.stitching.matching.evidence import Task
from vaoi_station.stitching.matching.scene import Scene

_FACTORS = (0.7, 1.4, 0.83, 1.2, 0.5, 2.0)
"""Sizes that are searched, relative to those of the board type.

A search for one size finds marks whose size differs by up to about 15 %."""
_ENOUGH = 3
"""Number of fiducials that suffices to find the board. With fewer, the outline must confirm the board's position."""


def wrong_size(
    board_type: BoardType, scene: Scene, expectation: Expectation, motion: Motion, texture_mm: Floats
) -> Reason | None:
    """Return a reason if marks of another size lie where the fiducials should be, otherwise None.

    Args:
        board_type: the board type whose fiducials were not found.
        scene: the frames of the run.
        expectation: expected position of the board.
        motion: motion of the rows, from links alone.
        texture_mm: (k, 2) linked points, which should lie on the board.
    """
    best: tuple[float, float] | None = None
    for factor in _FACTORS:
        cost = _cost(_resized(board_type, factor), scene, expectation, motion, texture_mm)
        if cost is not None and (best is None or cost < best[0]):
            best = cost, factor
    if best is None:
        return None
    stated = sorted({f.diameter for f in board_type.fiducials})
    sizes = ", ".join(f"{size * board_type.mm_per_unit:.2g} mm" for size in stated)
    found = ", ".join(f"about {size * best[1] * board_type.mm_per_unit:.2g} mm" for size in stated)
    return Reason(
        ReasonCode.FIDUCIAL_SIZE,
        f"marks of {found} are where fiducials of {sizes} are expected: correct the diameter of the fiducials in the "
        "board type",
    )


def _cost(
    board_type: BoardType, scene: Scene, expectation: Expectation, motion: Motion, texture_mm: Floats
) -> float | None:
    """Return the cost of the best position of the board, without unit; None if no position is found or confirmed."""
    plane = board_plane(board_type, scene.cameras[0])
    detections = [
        detect_marks(Task("marks", key), scene.prepared(key), scene.cameras[key[0]], board_type)
        for key in scene.present
    ]
    places = merge_detections(detections, scene.cameras, motion)
    angle = expected_angle(plane, typical_camera(scene.cameras), expectation)
    found = find_board(plane, places, angle, expectation, np.asarray(texture_mm))
    if isinstance(found, Failure):
        return None
    outline = measure_outline_contrast(board_type, plane.matrix(found.c), scene, motion)
    if len(found.fiducials) < min(_ENOUGH, len(board_type.fiducials)) or (outline is not None and not outline.visible):
        return None
    return found.cost if outline is not None or len(found.fiducials) >= _ENOUGH else None


def _resized(board_type: BoardType, factor: float) -> BoardType:
    resized = tuple(f.model_copy(update={"diameter": f.diameter * factor}) for f in board_type.fiducials)
    return board_type.model_copy(update={"fiducials": resized})
