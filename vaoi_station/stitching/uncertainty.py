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
from vaoi_station.stitching.adjustment import similar, similar_jacobian
from vaoi_station.stitching.cad import Frame
from vaoi_station.stitching.certainty import longest
from vaoi_station.stitching.evidence import FrameKey
from vaoi_station.stitching.problem import Adjusted
from vaoi_station.stitching.scene import Scene
from vaoi_station.stitching.surface import basis

MODEL_PX = 0.002
"""Standard deviation of what no residual shows: calibration, artwork, flatness."""


@dataclass(frozen=True, eq=False)
class Sigma:
    """Standard deviations in px, in the direction where they are largest; covariances are of x and y in one image."""

    rows_px: tuple[float, ...]
    """Of each row: of the worst component in view there, of the motion alone where there is none."""
    worst_px: float | None
    """The largest of all views of components; None without C."""
    views: dict[str, dict[FrameKey, Floats]]
    """(2, 2) px² of every view of every component, by address and frame."""

    def of_component(self, address: str) -> float | None:
        """The largest over a component's views."""
        views = list(self.views.get(address, {}).values())
        return float(longest(np.array(views)).max()) if views else None


def predicted_sigma(scene: Scene, frame: Frame | None, adjusted: Adjusted) -> Sigma:
    """Covariance of component positions in every image (of the board's corners, if it has no components)."""
    m = len(adjusted.motion.angle)
    motion = [_motion_sigma(scene.cameras, adjusted, j) for j in range(m)]
    if frame is None or adjusted.similarity is None:
        return Sigma(tuple(motion), None, {})
    parts = frame.board_type.components
    names = [p.address for p in parts] or ["low corner", "high corner"]
    cad = np.array([p.center for p in parts] or frame.board_type.extent()).reshape(-1, 2)
    board = similar(adjusted.similarity, frame.flat(cad))
    views: dict[str, dict[FrameKey, Floats]] = {}
    rows = [0.0] * m
    for key in scene.present:
        seen, covariance = _covariances(scene.cameras[key[0]], frame, adjusted, key[1], cad, board)
        for n, c in zip(seen.tolist(), covariance, strict=True):
            views.setdefault(names[n], {})[key] = c
        rows[key[1]] = max(rows[key[1]], float(longest(covariance).max(initial=0)))
    shown = [v for v in rows if v]
    return Sigma(tuple(v or w for v, w in zip(rows, motion, strict=True)), max(shown, default=None), views)


def surface_sigma_mm(frame: Frame, adjusted: Adjusted, cad: Floats) -> Floats:
    """Standard deviation (k,) of the board's height at CAD points (k, 2); 0 where no surface was sought."""
    f = len(adjusted.surface_mm)
    if not f:
        return np.zeros(len(cad))
    b = basis(frame.board_type, cad)
    return np.asarray(np.sqrt(np.einsum("ki,ij,kj->k", b, adjusted.covariance[-f:, -f:], b)))


def _covariances(
    camera: Camera, frame: Frame, adjusted: Adjusted, row: int, cad: Floats, board: Floats
) -> tuple[NDArray[np.int_], Floats]:
    """The points in view, and the covariance (k, 2, 2) px² of where they are in the image."""
    ground = adjusted.motion.row_from_tester(row)(board)
    seen = np.flatnonzero(camera.sees(camera.project(ground)))
    if not len(seen):
        return seen, np.zeros((0, 2, 2))
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
    covariance = j @ adjusted.covariance[np.ix_(at, at)] @ j.swapaxes(1, 2)
    return seen, covariance * camera.px_per_mm**2 + MODEL_PX**2 * np.eye(2)


def _motion_sigma(cameras: Sequence[Camera], adjusted: Adjusted, row: int) -> float:
    at = slice(3 * row + 1, 3 * row + 3)
    resolution = float(np.mean([camera.px_per_mm for camera in cameras]))
    return float(np.hypot(longest(adjusted.covariance[None, at, at])[0] * resolution, MODEL_PX))
