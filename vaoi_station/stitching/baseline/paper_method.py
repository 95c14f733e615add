"""Stitching of a run by the paper's method (`--method paper`): from complete frames, row by row, in one plane.

The method serves for comparison only. It uses no prior knowledge and no common adjustment, and it gives no uncertainty.
C is computed from the fiducials alone (equation 21).
"""

from __future__ import annotations

import time
from collections.abc import Sequence

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera, Euclidean
from vaoi_station.geometry.robust import Failure
from vaoi_station.model import Reason, ReasonCode, RecordingHead, Status, Stitch
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.baseline.paper_features import chain_rows
from vaoi_station.stitching.board.board_plane import board_plane, expected_angle, typical_camera
from vaoi_station.stitching.board.fiducial_assignment import find_board, merge_detections
from vaoi_station.stitching.board.fiducial_detection import detect_marks
from vaoi_station.stitching.matching.evidence import Task
from vaoi_station.stitching.matching.prepared_frame import PreparedFrame
from vaoi_station.stitching.recordings.offline import Frames
from vaoi_station.stitching.work import StitchSetup
from vaoi_station.version import __version__

NO_MEASURE = "the paper's method has no measure of its own error"
_BLANK = np.zeros((64, 64), dtype=np.uint8)


def stitch_by_paper(setup: StitchSetup, head: RecordingHead, frame: Frames) -> Stitch:
    """Stitch a finished run: join each row to the row before it by Harris corners, SIFT descriptors and RANSAC.

    Args:
        setup: cameras, board type and expectation of the run.
        head: head of the recording.
        frame: function that returns the pixels of a camera and a row; None where a frame never arrived.
    """
    start = time.perf_counter()
    frames = _prepared(head, frame)

    def grey(camera: int, row: int) -> NDArray[np.uint8]:
        # A blank frame stands for a missing one: it has no features, and the other cameras place the row.
        return frames[camera, row].grey if (camera, row) in frames else _BLANK

    motion = chain_rows(setup.cameras, head.rows, grey)
    if isinstance(motion, Failure):
        identity = tuple(np.eye(3) for _ in range(head.rows))
        nothing = tuple(tuple(None for _ in range(head.rows)) for _ in setup.cameras)
        broken = Reason(ReasonCode.ROWS_NOT_CHAINED, f"the chain of rows is broken: {motion.reason}")
        return _result(nothing, None, identity, (broken,), start)
    images = tuple(
        tuple(c.image_from_row.matrix @ d.matrix if (i, j) in frames else None for j, d in enumerate(motion))
        for i, c in enumerate(setup.cameras)
    )
    found = _cad_matrix(setup, frames, as_motion(motion, setup.cameras))
    rows = tuple(d.matrix for d in motion)
    if isinstance(found, Failure):
        return _result(images, None, rows, (Reason(ReasonCode(found.code), found.reason),), start)
    return _result(images, found, rows, (), start)


def as_motion(rows: Sequence[Euclidean], cameras: Sequence[Camera]) -> Motion:
    """Convert the D_j of all rows to a `Motion`, the form in which the rest of the stitching computes."""
    pivot = np.mean([c.row_from_image(c.center_px) for c in cameras], axis=0)
    back = [d.inverse() for d in rows]
    return Motion(np.array([b.angle_rad for b in back]), np.array([b(pivot) - pivot for b in back]), pivot)


def _prepared(head: RecordingHead, frame: Frames) -> dict[tuple[int, int], PreparedFrame]:
    keys = ((i, j) for i in range(len(head.cameras)) for j in range(head.rows))
    return {key: PreparedFrame(pixels) for key in keys if (pixels := frame(*key)) is not None}


def _cad_matrix(
    setup: StitchSetup, frames: dict[tuple[int, int], PreparedFrame], motion: Motion
) -> NDArray[np.float64] | Failure:
    if setup.board_type is None:
        return Failure("no board type was given, so there is no CAD mapping", ReasonCode.NO_BOARD_TYPE)
    frame = board_plane(setup.board_type, setup.cameras[0])
    detections = [detect_marks(Task("marks", k), p, setup.cameras[k[0]], setup.board_type) for k, p in frames.items()]
    places = merge_detections(detections, setup.cameras, motion)
    angle = expected_angle(frame, typical_camera(setup.cameras), setup.expectation)
    # No texture is given, since the paper uses the fiducials alone.
    guess = find_board(frame, places, angle, setup.expectation, np.zeros((0, 2)))
    return guess if isinstance(guess, Failure) else frame.matrix(guess.c)


def _result(
    images: tuple[tuple[NDArray[np.float64] | None, ...], ...],
    cad_matrix: NDArray[np.float64] | None,
    rows: tuple[NDArray[np.float64], ...],
    reasons: tuple[Reason, ...],
    start: float,
) -> Stitch:
    why = reasons or (Reason(ReasonCode.NO_ERROR_MEASURE, NO_MEASURE),)
    return Stitch(
        method="paper",
        image_matrices=images,
        cad_matrix=cad_matrix,
        row_motion=rows,
        status=Status.FAILED if reasons else Status.DEGRADED,
        reasons=tuple(text for _, text in why),
        reason_codes=tuple(code.value for code, _ in why),
        quality={
            "timings_ms": {"whole": round((time.perf_counter() - start) * 1e3, 3)},
            "software": f"vaoi_station {__version__}",
            "opencv": cv2.__version__,
        },
    )
