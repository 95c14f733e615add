"""Stitching of a run by the paper's method (`--method paper`): from complete frames, row by row, in one plane.

The method serves for comparison only. It uses no prior knowledge and no common adjustment, and it gives no uncertainty.
C is computed from the fiducials alone (equation 21). Rows are chained (section 3.3.2) by Harris corners, SIFT
descriptors and RANSAC: features are detected in complete frames without prior knowledge, and matched by brute force.
One Euclidean transform, estimated from the matches of all cameras, joins each row to the row before it (equations 15
and 16).
"""

from __future__ import annotations

import time
from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera, Euclidean, System
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Reason, ReasonCode, RecordingHead, Status, Stitch
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.board.board_plane import board_plane, expected_angle, typical_camera
from vaoi_station.stitching.board.fiducials import detect_marks, find_board, merge_detections
from vaoi_station.stitching.matching.evidence import Task
from vaoi_station.stitching.matching.frames import PreparedFrame
from vaoi_station.stitching.work import Frames, StitchSetup
from vaoi_station.version import __version__

_CORNERS = 600
"""Largest number of corners per frame, after the paper: "roughly 600 features were detected"."""
_KEYPOINT_PX = 12.0
_RATIO = 0.8
"""Largest ratio of the descriptor distance of the best match to that of the second best (Lowe 2004)."""
_RANSAC_MM = 0.05
_LEAST_MATCHES = 6


@dataclass(frozen=True, eq=False)
class Features:
    """The k features of one frame: corners `px` (k, 2) in raw pixels, and their SIFT descriptors (k, 128)."""

    px: Floats
    descriptors: NDArray[np.float32]


def detect_features(grey: NDArray[np.uint8]) -> Features:
    """Detect at most 600 Harris corners in a grey frame (h, w), and compute their SIFT descriptors."""
    corners = cv2.goodFeaturesToTrack(grey, _CORNERS, 0.001, 5, useHarrisDetector=True, k=0.04)
    if corners is None:
        return Features(np.zeros((0, 2)), np.zeros((0, 128), dtype=np.float32))
    points = [cv2.KeyPoint(float(x), float(y), _KEYPOINT_PX) for x, y in corners.reshape(-1, 2)]
    kept, descriptors = cv2.SIFT.create().compute(grey, points)
    return Features(np.array([p.pt for p in kept], dtype=np.float64), np.asarray(descriptors, dtype=np.float32))


def estimate_step(
    earlier: Sequence[Features], later: Sequence[Features], cameras: Sequence[Camera]
) -> Euclidean | Failure:
    """Estimate T of equation 15, the motion from ground points of the later row to those of the earlier row.

    Both rows have one entry of features per camera.
    """
    # Matches are converted to mm in the conveyor's plane, where one transform holds for all cameras.
    source, target = [], []
    for a, b, camera in zip(earlier, later, cameras, strict=True):
        if len(a.px) < 2 or len(b.px) < 2:
            continue
        for pair in cv2.BFMatcher(cv2.NORM_L2).knnMatch(b.descriptors, a.descriptors, k=2):
            if len(pair) == 2 and pair[0].distance < _RATIO * pair[1].distance:
                source.append(camera.ground(b.px[pair[0].queryIdx]))
                target.append(camera.ground(a.px[pair[0].trainIdx]))
    if len(source) < _LEAST_MATCHES:
        return Failure(f"{len(source)} matches between two rows; {_LEAST_MATCHES} are needed")
    # OpenCV's RANSAC uses a global random generator. With a fixed seed, the same frames give the same result.
    cv2.setRNGSeed(1)
    found, _ = cv2.estimateAffinePartial2D(
        np.array(source), np.array(target), method=cv2.RANSAC, ransacReprojThreshold=_RANSAC_MM, maxIters=5000
    )
    if found is None:
        return Failure("RANSAC found no consistent set of matches")
    return Euclidean.motion(float(np.arctan2(found[1, 0], found[0, 0])), found[:, 2], System.ROW, System.ROW)


def chain_rows(
    cameras: Sequence[Camera], rows: int, grey: Callable[[int, int], NDArray[np.uint8]]
) -> list[Euclidean] | Failure:
    """Estimate D_j of every row by the paper's chain, M_{i,j+1} = M_{i,j} T⁻¹ (equation 16), from grey frames."""
    tester_from_row = np.eye(3)
    motion = [Euclidean.identity(System.ROW, System.TESTER)]
    before = [detect_features(grey(i, 0)) for i in range(len(cameras))]
    for j in range(1, rows):
        now = [detect_features(grey(i, j)) for i in range(len(cameras))]
        t = estimate_step(before, now, cameras)
        if isinstance(t, Failure):
            return Failure(f"rows {j - 1} and {j}: {t.reason}")
        tester_from_row = tester_from_row @ t.matrix
        motion.append(Euclidean(tester_from_row, System.TESTER, System.ROW).inverse())
        before = now
    return motion


NO_MEASURE = "the paper's method has no measure of its own error"
_BLANK = np.zeros((64, 64), dtype=np.uint8)


def stitch_by_paper(setup: StitchSetup, head: RecordingHead, frame: Frames) -> Stitch:
    """Stitch a finished run; `frame` returns the pixels of a camera and a row, None where a frame never arrived."""
    start = time.perf_counter()
    keys = ((i, j) for i in range(len(head.cameras)) for j in range(head.rows))
    frames = {key: PreparedFrame(pixels) for key in keys if (pixels := frame(*key)) is not None}

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
    pivot = np.mean([c.row_from_image(c.center_px) for c in setup.cameras], axis=0)
    back = [d.inverse() for d in motion]
    moved = Motion(np.array([b.angle_rad for b in back]), np.array([b(pivot) - pivot for b in back]), pivot)
    found = _cad_matrix(setup, frames, moved)
    rows = tuple(d.matrix for d in motion)
    if isinstance(found, Failure):
        return _result(images, None, rows, (Reason(ReasonCode(found.code), found.reason),), start)
    return _result(images, found, rows, (), start)


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
        reasons=tuple(reason.message for reason in why),
        reason_codes=tuple(reason.code for reason in why),
        quality={
            "timings_ms": {"whole": round((time.perf_counter() - start) * 1e3, 3)},
            "software": f"vaoi_station {__version__}",
            "opencv": cv2.__version__,
        },
    )
