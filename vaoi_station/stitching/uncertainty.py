"""How far a position can be trusted: the covariance of the adjustment, carried to the images.

A component's place in an image follows from its row, from C and from the surface; its covariance is
that of the misfit a sighting of it would have.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment import Adjusted, similar, similar_jacobian
from vaoi_station.stitching.cad import Frame
from vaoi_station.stitching.scene import Scene
from vaoi_station.stitching.surface import basis

MODEL_PX = 0.03
"""Standard deviation of what no residual shows: calibration, artwork, flatness."""


@dataclass(frozen=True)
class Sigma:
    """Standard deviations per axis, in px."""

    rows_px: tuple[float, ...]
    """Of each row: of the worst component in view there; of the motion alone where there is none."""
    worst_px: float | None
    """The largest of all views of components; None without C."""


def predicted_sigma(scene: Scene, frame: Frame | None, adjusted: Adjusted) -> Sigma:
    """Standard deviation of component positions in every row (of the board's corners, if it has no components)."""
    m = len(adjusted.motion.angle)
    present = set(scene.present)
    motion = [_motion_sigma(scene.cameras, adjusted, j) for j in range(m)]
    if frame is None or adjusted.similarity is None:
        return Sigma(tuple(motion), None)
    cad = np.array([c.center for c in frame.board_type.components]).reshape(-1, 2)
    if not len(cad):
        cad = np.array(frame.board_type.extent())
    board = similar(adjusted.similarity, frame.flat(cad))
    rows, shown = [], []
    for j in range(m):
        filming = [camera for i, camera in enumerate(scene.cameras) if (i, j) in present]
        worst = max((_worst(camera, frame, adjusted, j, cad, board) for camera in filming), default=0.0)
        shown += [worst] if worst else []
        rows.append(worst or motion[j])
    return Sigma(tuple(rows), max(shown, default=None))


def _worst(camera: Camera, frame: Frame, adjusted: Adjusted, row: int, cad: Floats, board: Floats) -> float:
    """The largest standard deviation over the points in view; 0 if there are none."""
    ground = adjusted.motion.row_from_tester(row)(board)
    seen = camera.sees(camera.project(ground))
    if not seen.any():
        return 0.0
    ground, cad = ground[seen], cad[seen]
    motion, m, n = adjusted.motion, len(adjusted.motion.angle), adjusted.covariance.shape[0]
    rows = np.full(len(ground), row)
    arm = motion.turned(rows, ground - motion.pivot)
    one, nil = np.ones(len(arm)), np.zeros(len(arm))
    parts = [
        np.stack([np.stack([-arm[:, 1], one, nil], -1), np.stack([arm[:, 0], nil, one], -1)], 1),
        -similar_jacobian(frame.flat(cad)),
    ]
    if n > 3 * m + 4:
        lean = motion.turned(rows, camera.parallax(ground))
        parts.append(lean[:, :, None] * basis(frame.board_type, cad)[:, None, :])
    j = np.concatenate(parts, 2)
    at: NDArray[np.int_] = np.concatenate([np.arange(3 * row, 3 * row + 3), np.arange(3 * m, n)])
    variance = np.einsum("kif,fg,kig->k", j, adjusted.covariance[np.ix_(at, at)], j) / 2
    return float(np.hypot(np.sqrt(max(float(variance.max()), 0.0)) * camera.px_per_mm, MODEL_PX))


def _motion_sigma(cameras: Sequence[Camera], adjusted: Adjusted, row: int) -> float:
    at = slice(3 * row + 1, 3 * row + 3)
    resolution = float(np.mean([camera.px_per_mm for camera in cameras]))
    return float(np.hypot(np.sqrt(max(np.trace(adjusted.covariance[at, at]) / 2, 0)) * resolution, MODEL_PX))
