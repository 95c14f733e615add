"""Cameras that delivered nothing of a whole board, and what of the board they alone would have shown."""

from __future__ import annotations

import numpy as np

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.similarity import apply_similarity
from vaoi_station.stitching.board.board_plane import BoardPlane, expected_angle
from vaoi_station.stitching.board.expectation import Expectation
from vaoi_station.stitching.matching.scene import Scene


def absent_camera_reasons(
    scene: Scene, plane: BoardPlane | None, expectation: Expectation, motion: Motion
) -> list[str]:
    """A sentence for every camera of which no good frame arrived, with the fiducials that lay in its view alone.

    Args:
        scene: cameras, and the frames that arrived whole.
        frame: of the board type whose fiducials were sought; None if none were.
        expectation: where the board should lie. If it leaves the place open, so do the sentences.
        motion: of the rows, as far as the other cameras tell it.
    """
    there = {camera for camera, _ in scene.present}
    away = [i for i in range(len(scene.cameras)) if i not in there]
    if not away:
        return []
    board_mm = None if plane is None else expected_fiducials(plane, scene, expectation)
    if plane is None or board_mm is None:
        unknown = "" if plane is None else ": a fiducial in its view cannot be found"
        return [f"camera {i} delivered no whole frame of this board{unknown}" for i in away]
    names = np.array([f.name for f in plane.board_type.fiducials])
    shown = np.zeros(len(names), dtype=np.bool_)
    for i, row in scene.present:
        shown |= _seen(scene, i, row, motion, board_mm)
    rows = range(len(motion.angle))
    hidden = {i: ~shown & np.any([_seen(scene, i, j, motion, board_mm) for j in rows], axis=0) for i in away}
    return [f"camera {i} delivered no whole frame of this board{_lost(names[hidden[i]].tolist())}" for i in away]


def expected_fiducials(plane: BoardPlane, scene: Scene, expectation: Expectation) -> Floats | None:
    """(k, 2) tester mm of the fiducials in the first row if the board lies as expected; None if that says not where."""
    x, y = expectation.corner_mm
    if x is None or y is None:
        return None
    angle, scale = expected_angle(plane, scene.cameras[0], expectation), plane.board_type.mm_per_unit
    turn = np.array([scale * np.cos(angle), scale * np.sin(angle), 0.0, 0.0])
    low, high = plane.board_type.extent()
    corners = plane.flat(np.array([(low[0], low[1]), (high[0], low[1]), (high[0], high[1]), (low[0], high[1])]))
    shift = np.array((x, y)) - apply_similarity(turn, corners).min(0)
    return np.asarray(apply_similarity(turn, plane.fiducials) + shift)


def _seen(scene: Scene, camera: int, row: int, motion: Motion, board_mm: Floats) -> np.ndarray:
    """(k,) which places of the board lie in one frame."""
    eye = scene.cameras[camera]
    return eye.sees(eye.project(apply(motion.rows_from_tester[row], board_mm)))


def _lost(fiducials: list[str]) -> str:
    if not fiducials:
        return ""
    return f", and in its view alone lay the fiducial{'s' if len(fiducials) > 1 else ''} {', '.join(fiducials)}"
