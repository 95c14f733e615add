"""The paper's chain of rows (section 3.3.2), kept for comparison: Harris corners, SIFT descriptors, RANSAC.

Features are detected in complete frames without prior knowledge, and matched by brute force. One Euclidean transform,
estimated from the matches of all cameras, joins each row to the row before it (equations 15 and 16).
"""

from __future__ import annotations

from collections.abc import Callable, Sequence
from dataclasses import dataclass

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera, Euclidean, System
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats

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

    Args:
        earlier: features of the earlier row, one entry per camera.
        later: features of the later row, one entry per camera.
        cameras: the cameras, in the same order.
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
    """Estimate D_j of every row by the paper's chain, M_{i,j+1} = M_{i,j} T⁻¹ (equation 16).

    Args:
        cameras: the cameras.
        rows: number of rows.
        grey: function that returns the grey frame of a camera and a row.
    """
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
