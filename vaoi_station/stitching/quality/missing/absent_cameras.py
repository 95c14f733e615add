"""Cameras that delivered no good frame of a run, and the fiducials that only these cameras would have shown."""

from __future__ import annotations

import numpy as np

from vaoi_station.geometry.similarity import apply_similarity
from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.model import Reason, ReasonCode
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.board.board_plane import BoardPlane, expected_angle, typical_camera
from vaoi_station.stitching.board.expectation import Expectation
from vaoi_station.stitching.matching.scene import Scene


def absent_camera_reasons(
    scene: Scene, plane: BoardPlane | None, expectation: Expectation, motion: Motion
) -> list[Reason]:
    """Return one reason for each camera without a good frame; it names the fiducials that only this camera would show.

    Args:
        scene: the cameras and the complete frames.
        plane: plane of the board type whose fiducials were searched; None if none were searched.
        expectation: expected position of the board. If the position is unknown, no fiducials are named.
        motion: motion of the rows, from the other cameras.
    """
    delivered = {camera for camera, _ in scene.present}
    absent = [i for i in range(len(scene.cameras)) if i not in delivered]
    if not absent:
        return []
    board_mm = None if plane is None else expected_fiducials(plane, scene, expectation)
    if plane is None or board_mm is None:
        unknown = "" if plane is None else ": fiducials that only this camera shows cannot be found"
        return [_absent(i, unknown) for i in absent]
    names = np.array([f.name for f in plane.board_type.fiducials])
    # The neighbouring camera also shows a fiducial in the overlap. Only the other fiducials are lost.
    shown = np.zeros(len(names), dtype=np.bool_)
    for i, row in scene.present:
        shown |= _in_frame(scene, i, row, motion, board_mm)
    rows = range(len(motion.angle))
    hidden = {i: ~shown & np.any([_in_frame(scene, i, j, motion, board_mm) for j in rows], axis=0) for i in absent}
    return [_absent(i, _hidden_clause(names[hidden[i]].tolist())) for i in absent]


def _absent(camera: int, clause: str) -> Reason:
    return Reason(ReasonCode.CAMERA_ABSENT, f"camera {camera} delivered no complete frame of this board{clause}")


def expected_fiducials(plane: BoardPlane, scene: Scene, expectation: Expectation) -> Floats | None:
    """Compute the expected tester coordinates (k, 2) of the fiducials in row 0; None if no position is expected."""
    x, y = expectation.corner_mm
    if x is None or y is None:
        return None
    angle, scale = expected_angle(plane, typical_camera(scene.cameras), expectation), plane.board_type.mm_per_unit
    turn = np.array([scale * np.cos(angle), scale * np.sin(angle), 0.0, 0.0])
    low, high = plane.board_type.extent()
    corners = plane.flat(np.array([(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]))
    # For every rotation, the expectation holds the lowest x and y of the board as it lies, that is, after the rotation.
    shift = np.array((x, y)) - apply_similarity(turn, corners).min(0)
    return np.asarray(apply_similarity(turn, plane.fiducials) + shift)


def _in_frame(scene: Scene, camera: int, row: int, motion: Motion, board_mm: Floats) -> np.ndarray:
    """Return for each board point (k, 2), tester mm, whether one frame shows it."""
    model = scene.cameras[camera]
    return model.sees(model.project(apply(motion.rows_from_tester[row], board_mm)))


def _hidden_clause(fiducials: list[str]) -> str:
    if not fiducials:
        return ""
    return f", and no other camera shows the fiducial{'s' if len(fiducials) > 1 else ''} {', '.join(fiducials)}"
