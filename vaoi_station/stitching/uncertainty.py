"""How far a position can be trusted: the covariance of the adjustment, carried to the images.

A component's place in an image follows from its row, from C and from the surface; its covariance is
that of the misfit a sighting of it would have.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from functools import cached_property

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment import similar, similar_jacobian
from vaoi_station.stitching.cad import Frame
from vaoi_station.stitching.certainty import longest
from vaoi_station.stitching.evidence import FrameKey
from vaoi_station.stitching.observations import Ints
from vaoi_station.stitching.problem import Adjusted
from vaoi_station.stitching.scene import Scene
from vaoi_station.stitching.surface import basis

MODEL_PX = 0.002
"""Standard deviation of what no residual shows: calibration, artwork, flatness."""
_DIGITS = 4


@dataclass(frozen=True, eq=False)
class Sigma:
    """Standard deviations in px, in the direction where they are largest; covariances are of x and y in one image."""

    rows_px: tuple[float, ...]
    """Of each row: of the worst component in view there, of the motion alone where there is none."""
    worst_px: float | None
    """The largest of all views of components; None without C."""
    names: tuple[str, ...]
    """Addresses of the components."""
    part: Ints
    """(k,) which component a view shows; views of one component stand in the order of cameras and rows."""
    seen_in: Ints
    """(k, 2) camera and row of every view."""
    covariance_px2: Floats
    """(k, 2, 2) of every view."""

    @cached_property
    def views(self) -> dict[str, dict[FrameKey, Floats]]:
        """(2, 2) px² of every view of every component, by address and frame."""
        out: dict[str, dict[FrameKey, Floats]] = {}
        for n, (i, j), c in zip(self.part.tolist(), self.seen_in.tolist(), self.covariance_px2, strict=True):
            out.setdefault(self.names[n], {})[i, j] = c
        return out

    @cached_property
    def of_components(self) -> dict[str, float]:
        """The largest over each component's views, by address, of those that are in view."""
        worst = np.zeros(len(self.names))
        np.maximum.at(worst, self.part, longest(self.covariance_px2))
        return {name: float(px) for name, px in zip(self.names, worst, strict=True) if px}

    def told(self) -> dict[str, list[list[float]]]:
        """[camera, row, xx, xy, yy] of every view, by address; four digits, wherever the point."""
        values = self.covariance_px2[:, (0, 0, 1), (0, 1, 1)]
        with np.errstate(divide="ignore"):
            digits = _DIGITS - 1 - np.floor(np.log10(np.abs(values)))
        unit = 10.0 ** np.where(np.isfinite(digits), digits, 0)
        out: dict[str, list[list[float]]] = {}
        for n, frame, entry in zip(
            self.part.tolist(), self.seen_in.tolist(), (np.round(values * unit) / unit).tolist(), strict=True
        ):
            out.setdefault(self.names[n], []).append(frame + entry)
        return out


def predicted_sigma(scene: Scene, frame: Frame | None, adjusted: Adjusted) -> Sigma:
    """Covariance of component positions in every image (of the board's corners, if it has no components)."""
    m = len(adjusted.motion.angle)
    motion = [_motion_sigma(scene.cameras, adjusted, j) for j in range(m)]
    if frame is None or adjusted.similarity is None:
        none = np.zeros(0, dtype=np.int_)
        return Sigma(tuple(motion), None, (), none, np.zeros((0, 2), dtype=np.int_), np.zeros((0, 2, 2)))
    parts = frame.parts
    names = parts.addresses or ("low corner", "high corner")
    cad = parts.center if len(parts.center) else np.array(frame.board_type.extent())
    places = _Places(frame, adjusted, cad)
    views = [places.seen_by(number, camera, scene.present) for number, camera in enumerate(scene.cameras)]
    part, seen_in, covariance = (np.concatenate([v[n] for v in views]) for n in range(3))
    rows = np.zeros(m)
    np.maximum.at(rows, seen_in[:, 1], longest(covariance))
    worst = float(rows.max(initial=0)) or None
    by_row = tuple(float(v) or w for v, w in zip(rows, motion, strict=True))
    return Sigma(by_row, worst, names, part, seen_in, covariance)


def surface_sigma_mm(frame: Frame, adjusted: Adjusted, cad: Floats) -> Floats:
    """Standard deviation (k,) of the board's height at CAD points (k, 2); 0 where no surface was sought."""
    f = len(adjusted.surface_mm)
    if not f:
        return np.zeros(len(cad))
    b = basis(frame.board_type, cad)
    return np.asarray(np.sqrt(np.einsum("ki,ij,kj->k", b, adjusted.covariance[-f:, -f:], b)))


class _Places:
    """Points of the board, and how far the adjustment lets them be off in every row."""

    def __init__(self, frame: Frame, adjusted: Adjusted, cad: Floats) -> None:
        """`cad` (n, 2)."""
        assert adjusted.similarity is not None
        self._motion, m = adjusted.motion, len(adjusted.motion.angle)
        board = similar(adjusted.similarity, frame.flat(cad))
        self._ground = np.stack([self._motion.row_from_tester(j)(board) for j in range(m)])
        self._by_similarity = -similar_jacobian(frame.flat(cad))
        more = np.arange(3 * m, adjusted.covariance.shape[0])
        self._basis = basis(frame.board_type, cad) if len(more) > self._by_similarity.shape[2] else None
        at = [np.concatenate([np.arange(3 * j, 3 * j + 3), more]) for j in range(m)]
        self._covariance = np.stack([adjusted.covariance[np.ix_(k, k)] for k in at])
        """(m, u, u) of the unknowns that a point in a row hangs on."""

    def seen_by(self, number: int, camera: Camera, present: Sequence[FrameKey]) -> tuple[Ints, Ints, Floats]:
        """Points (k,) in view of a camera, camera and row (k, 2), and covariances (k, 2, 2) px² in the image."""
        rows = np.array([row for i, row in present if i == number], dtype=np.int_)
        low, high = camera.view_mm()
        x, y = self._ground[rows, :, 0], self._ground[rows, :, 1]
        at, point = np.nonzero((x >= low[0]) & (x <= high[0]) & (y >= low[1]) & (y <= high[1]))
        seen = camera.sees(camera.project(self._ground[rows[at], point]))
        row, point = rows[at[seen]], point[seen]
        j = self._jacobian(camera, row, point)
        covariance = j @ self._covariance[row] @ j.swapaxes(1, 2)
        covariance = covariance * camera.px_per_mm**2 + MODEL_PX**2 * np.eye(2)
        return point, np.column_stack([np.full(len(row), number), row]), covariance

    def _jacobian(self, camera: Camera, row: Ints, point: Ints) -> Floats:
        """Derivative (k, 2, u) of the misfit a sighting of a point in a row would have."""
        ground = self._ground[row, point]
        arm = self._motion.turned(row, ground - self._motion.pivot)
        one, nil = np.ones(len(arm)), np.zeros(len(arm))
        by_row = np.stack([np.stack([-arm[:, 1], one, nil], -1), np.stack([arm[:, 0], nil, one], -1)], 1)
        parts = [by_row, self._by_similarity[point]]
        if self._basis is not None:
            lean = self._motion.turned(row, camera.parallax(ground))
            parts.append(lean[:, :, None] * self._basis[point][:, None, :])
        return np.concatenate(parts, 2)


def _motion_sigma(cameras: Sequence[Camera], adjusted: Adjusted, row: int) -> float:
    at = slice(3 * row + 1, 3 * row + 3)
    resolution = float(np.mean([camera.px_per_mm for camera in cameras]))
    return float(np.hypot(longest(adjusted.covariance[None, at, at])[0] * resolution, MODEL_PX))
