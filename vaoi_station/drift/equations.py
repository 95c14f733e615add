"""A second adjustment of a run, in which the displacements of all cameras are additional unknowns.

Links and fiducial detections are those of the stitching. The equations are those of the first adjustment, with three
more unknowns per camera. The other unknowns (motion of the rows, C, height of the board) are eliminated from the normal
equations. Pictures of a board never show a motion of the whole array, so the remaining information matrix is singular
in these directions. `attribution` then decides which camera has moved.
"""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass

import numpy as np

from vaoi_station.drift.displacement import PARAMETERS, displace_camera
from vaoi_station.drift.evidence import RunEvidence
from vaoi_station.geometry import Camera
from vaoi_station.geometry.robust import huber_weights, median_sigma
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.normal_blocks import Block, belt_blocks, square_roots, sum_blocks, whiten
from vaoi_station.stitching.adjustment.observations import Ints
from vaoi_station.stitching.adjustment.similarity import apply_similarity, similarity_jacobian

_ITERATIONS = 15
_HELD_ITERATIONS = 2
"""Number of first iterations without displacements, which give the residuals under the calibration."""
_CONVERGED_PX = 1e-3
_STEP_PX = 0.05
"""Step of the numeric derivatives by a displacement. The functions are smooth over hundreds of px."""
_ANYWHERE_PX = 100.0
_FIRST_FLOOR_PX = 20.0
"""First value of the scatter of links. It is large, so that links to a knocked camera do not count as outliers."""
_FLOOR_PX = (0.010, 20.0)
_PATIENCE = 0.25
"""Smallest ratio of the scatter of one step to the scatter of the step before."""
_PAIR_SIGMA_PX, _PAIR_SHARE = 0.010, 0.25
"""Error that all links of one pair of frames share: in px, and as a share of the scatter; the larger one counts.

The adjustment of a run uses the same model."""
_FIDUCIAL_SIGMA_PX = 0.05
"""Noise added to fiducial detections: those made while filming are less precise than those of the result."""
_KNEE, _CUT = 2.0, 6.0
_SCALE_SIGMA = 3e-4
"""Relative standard deviation of the scale between a board and its CAD data."""


@dataclass(frozen=True, eq=False)
class DisplacementEstimate:
    """The displacements d̂ of n cameras estimated from one run, as normal equations.

    A displacement d fits the run the worse, the larger (d − d̂)ᵀ·information·(d − d̂) is.
    """

    information: Floats
    """(3n, 3n) px⁻², information matrix of d̂; singular for motions of the whole array."""
    vector: Floats
    """(3n,) px⁻¹, the product information · d̂. It is finite even where d̂ is undetermined."""
    rms_px: Floats
    """(n,) rms residual, without displacements, of links to neighbouring cameras and fiducials; NaN if none exist."""
    left_px: Floats
    """(n,) rms of the same residuals after the estimated displacements are applied."""
    links: Ints
    """(n,) number of links to neighbouring cameras that were used."""
    fiducials: Ints
    """(n,) number of fiducial detections that were used."""


def estimate_displacements(run: RunEvidence) -> DisplacementEstimate:
    """Estimate the displacements of the cameras from one run.

    Args:
        run: links and fiducials of a run under the calibration in force.
    """
    solver = _Solver(run)
    for _ in range(_HELD_ITERATIONS):
        solver.step(held=True)
    solver.release()
    for _ in range(_ITERATIONS):
        if solver.step() < _CONVERGED_PX and solver.settled:
            break
    return solver.estimate()


class _Solver:
    def __init__(self, run: RunEvidence) -> None:
        self.run = run
        self.n, self.m = len(run.cameras), len(run.motion.angle)
        self.d = np.zeros((self.n, PARAMETERS))
        self.motion = run.motion
        self.c = None if run.similarity is None else run.similarity.copy()
        self.height = np.zeros(run.surface.sigma_mm.shape[0])
        self.rows_at = PARAMETERS * self.n
        self.c_at = self.rows_at + 3 * self.m
        self.height_at = self.c_at + (4 if self.c is not None else 0)
        self.size = self.height_at + len(self.height)
        self.floor_px = {False: _FIRST_FLOOR_PX, True: _FIRST_FLOOR_PX}
        self.same_row = run.links.p == run.links.q
        self.used = np.zeros(len(run.links))
        self.fresh = self.settled = True
        self.held: tuple[Floats, Floats] = (np.zeros(0), np.zeros(0))

    def step(self, *, held: bool = False) -> float:
        """Take one Gauss-Newton step with robust weights; return the largest change of a displacement, px.

        If `held` is true, all displacements stay as they are.
        """
        self._project()
        normal, right = sum_blocks([*self._links(), *self._belt(), *self._fiducials(), *self._height()], self.size)
        # The gauge: D_0 is the identity. The three equations of row 0 are replaced by "no change".
        first = slice(self.rows_at, self.rows_at + 3)
        normal[first, :] = normal[:, first] = 0
        normal[first, first], right[first] = np.eye(3), 0
        # Schur complement: it eliminates the unknowns of the run, and the displacements of the cameras remain.
        own = slice(self.rows_at, None)
        tied = np.linalg.solve(normal[own, own], np.column_stack([normal[own, : self.rows_at], right[own]]))
        cross = normal[: self.rows_at, own]
        self.information = normal[: self.rows_at, : self.rows_at] - cross @ tied[:, :-1]
        # Rounding makes the matrix slightly asymmetric, but only one triangle of it is stored.
        self.information = (self.information + self.information.T) / 2
        self.vector = right[: self.rows_at] - cross @ tied[:, -1] + self.information @ self.d.ravel()
        # A weak prior makes the system regular; which camera has moved is decided later.
        still = np.eye(self.rows_at) / _ANYWHERE_PX**2
        found = np.linalg.solve(self.information + still, self.vector)
        change = np.zeros_like(self.d) if held else found.reshape(self.n, PARAMETERS) - self.d
        self._move(change, tied[:, -1] - tied[:, :-1] @ change.ravel())
        return float(np.abs(change).max())

    def release(self) -> None:
        """Store the residuals of the calibrated cameras. From now on, steps may move the cameras (`held` is false)."""
        self._project()
        self.held = self._squares()
        # Weights start anew: links to a knocked camera were outliers as long as its displacement was held at zero.
        self.fresh, self.floor_px = True, {False: _FIRST_FLOOR_PX, True: _FIRST_FLOOR_PX}

    def _move(self, change: Floats, rest: Floats) -> None:
        self.d = self.d + change
        rows = rest[: 3 * self.m].reshape(self.m, 3)
        self.motion = Motion(self.motion.angle + rows[:, 0], self.motion.shift + rows[:, 1:], self.motion.pivot)
        if self.c is not None:
            self.c = self.c + rest[3 * self.m : 3 * self.m + 4]
        self.height = self.height + rest[self.height_at - self.rows_at :]

    def _project(self) -> None:
        """Map links and detections to the ground with the present displacements; store points and derivatives."""
        run, cameras = self.run, self.run.cameras
        self.a, self.a_by = _ground(cameras, self.d, run.camera_a, run.a_px)
        self.b, self.b_by = _ground(cameras, self.d, run.camera_b, run.b_px)
        self.f, self.f_by = _ground(cameras, self.d, run.camera_f, run.f_px)

    def _residuals(self) -> tuple[Floats, Floats]:
        """Compute the residuals (k, 2) mm of the k links, and their change (k, 2) per mm of the board's height."""
        o, motion = self.run.links, self.motion
        lean = motion.turned(o.q, o.b_lean) - motion.turned(o.p, o.a_lean)
        rise = self.run.surface.at_links @ self.height
        return motion.board(o.q, self.b) - motion.board(o.p, self.a) + lean * rise[:, None], lean

    def _fiducial_residuals(self) -> tuple[Floats, Floats]:
        """Compute the residuals (s, 2) mm of the s detections, and their change (s, 2) per mm of the board's height."""
        s, run = self.run.fiducials, self.run
        assert s is not None
        assert self.c is not None
        lean = self.motion.turned(s.row, s.lean)
        rise = run.surface.at_fiducials @ self.height
        return self.motion.board(s.row, self.f) + lean * rise[:, None] - apply_similarity(self.c, s.cad), lean

    def _weights(self, residual: Floats) -> Floats:
        """Compute robust weights (k, 2, 2) mm⁻². A link weighs less if its pair of frames has many links."""
        o, self.settled = self.run.links, not self.fresh
        for kind in (False, True):
            px = (residual * o.px_per_mm[:, None])[self.same_row == kind]
            if len(px) and not self.fresh:
                scatter = float(np.clip(median_sigma(px), *_FLOOR_PX))
                # The scatter shrinks slowly, since correct links to a knocked camera need some steps to prevail.
                least = _PATIENCE * self.floor_px[kind]
                self.settled = self.settled and scatter >= least
                self.floor_px[kind] = max(scatter, least)
        self.fresh = False
        floor = np.where(self.same_row, self.floor_px[True], self.floor_px[False])
        variance = o.noise_mm2 + ((floor / o.px_per_mm) ** 2)[:, None, None] * np.eye(2)
        information = np.asarray(np.linalg.inv(variance), dtype=np.float64)
        chi = np.sqrt((whiten(square_roots(information), residual) ** 2).sum(0) / 2)
        self.used = np.where(chi > _CUT, 0.0, huber_weights(chi, _KNEE))
        per_pair = np.bincount(o.group, self.used, minlength=len(o.groups))
        shared = np.maximum(_PAIR_SIGMA_PX, _PAIR_SHARE * floor)
        share = 1 / (1 + per_pair[o.group] * (shared / floor) ** 2)
        return np.asarray(information * (self.used * share)[:, None, None])

    def _links(self) -> Iterator[Block]:
        """Compute the blocks of the normal equations that come from links, one block per pair of frames."""
        o, run = self.run.links, self.run
        if not len(o):
            return
        residual, lean = self._residuals()
        root = square_roots(self._weights(residual))
        parts = [
            -_turned(self.motion, o.p, self.a_by),
            _turned(self.motion, o.q, self.b_by),
            -_row_jacobian(self.motion, o.p, self.a),
            _row_jacobian(self.motion, o.q, self.b),
            lean[:, :, None] * run.surface.at_links[:, None, :],
        ]
        a, b = whiten(root, np.concatenate(parts, 2)), whiten(root, residual)
        for group, e in enumerate(o.groups):
            at = slice(*np.searchsorted(o.group, [group, group + 1]))
            partner = e.task.b or e.task.a
            columns = self._columns((e.task.a[0], partner[0]), (e.task.a[1], partner[1]))
            yield Block(columns, a[:, at].reshape(-1, a.shape[2]), b[:, at].ravel())

    def _columns(self, cameras: tuple[int, ...], rows: tuple[int, ...], *, with_c: bool = False) -> Ints:
        three = np.arange(3)
        return np.concatenate(
            [
                *(PARAMETERS * i + three for i in cameras),
                *(self.rows_at + 3 * j + three for j in rows),
                np.arange(self.c_at if with_c else self.height_at, self.size),
            ]
        )

    def _belt(self) -> list[Block]:
        """Compute the blocks of the normal equations that keep the rows near the conveyor's measured mean velocity."""
        if self.m < 2:
            return []
        dt = np.diff(self.run.times_s)
        velocity = -np.median(np.diff(self.motion.shift, axis=0) / dt[:, None], axis=0)
        blocks = belt_blocks(self.motion, self.run.times_s, velocity)
        return [Block(block.columns + self.rows_at, block.a, block.b) for block in blocks]

    def _fiducials(self) -> Iterator[Block]:
        s = self.run.fiducials
        if s is None or self.c is None:
            return
        residual, lean = self._fiducial_residuals()
        sigma = np.hypot(s.sigma_mm, _FIDUCIAL_SIGMA_PX / s.px_per_mm)
        chi = np.sqrt((residual**2).sum(1) / 2) / sigma
        weight = (np.sqrt(huber_weights(chi, _KNEE)) / sigma)[:, None]
        parts = [
            _turned(self.motion, s.row, self.f_by),
            _row_jacobian(self.motion, s.row, self.f),
            -similarity_jacobian(s.cad),
            lean[:, :, None] * self.run.surface.at_fiducials[:, None, :],
        ]
        a, b = weight[:, :, None] * np.concatenate(parts, 2), weight * residual
        for k, (camera, row) in enumerate(zip(self.run.camera_f.tolist(), s.row.tolist(), strict=True)):
            yield Block(self._columns((camera,), (row,), with_c=True), a[k], b[k])
        scale = float(np.hypot(*self.c[:2]))
        sigma_scale = _SCALE_SIGMA * self.run.nominal_scale
        off = np.array([(scale - self.run.nominal_scale) / sigma_scale])
        yield Block(np.arange(self.c_at, self.c_at + 2), self.c[None, :2] / scale / sigma_scale, off)

    def _height(self) -> list[Block]:
        sigma = self.run.surface.sigma_mm
        return [Block(np.arange(self.height_at, self.size), np.diag(1 / sigma), self.height / sigma)]

    def _squares(self) -> tuple[Floats, Floats]:
        """Compute the squared residuals, px², of the k links and of the s fiducial detections."""
        residual, _ = self._residuals()
        links = ((residual * self.run.links.px_per_mm[:, None]) ** 2).sum(1)
        if self.run.fiducials is None:
            return links, np.zeros(0)
        off, _ = self._fiducial_residuals()
        return links, ((off * self.run.fiducials.px_per_mm[:, None]) ** 2).sum(1)

    def estimate(self) -> DisplacementEstimate:
        """Return the estimate after the last step, with residuals and numbers of links and fiducials per camera."""
        run = self.run
        self._project()
        if len(run.links):
            self._weights(self._residuals()[0])
        kept = np.flatnonzero(self.same_row & (self.used > 0.1))
        links = sum(np.bincount(camera[kept], minlength=self.n) for camera in (run.camera_a, run.camera_b))
        marks = np.bincount(run.camera_f, minlength=self.n)
        before, after = (self._rms(squares, kept, links + marks) for squares in (self.held, self._squares()))
        return DisplacementEstimate(self.information, self.vector, before, after, np.asarray(links), marks)

    def _rms(self, squares: tuple[Floats, Floats], kept: Ints, count: Ints) -> Floats:
        """Compute each camera's rms residual (n,) px, over used links to neighbours and fiducials; NaN without any."""
        run, (links, marks) = self.run, squares
        total = np.bincount(run.camera_f, marks, minlength=self.n)
        for camera in (run.camera_a, run.camera_b):
            total = total + np.bincount(camera[kept], links[kept], minlength=self.n)
        return np.asarray(np.sqrt(np.divide(total, count, out=np.full(self.n, np.nan), where=count > 0)))


def _ground(cameras: Sequence[Camera], d: Floats, which: Ints, px: Floats) -> tuple[Floats, Floats]:
    """Map undistorted pixels `px` (k, 2) of the cameras numbered `which` (k,) to ground points (k, 2) mm.

    `d` (n, 3) are the displacements of the cameras. Also return the derivatives (k, 2, 3) of the points by them.
    """
    ground, by = np.zeros((len(px), 2)), np.zeros((len(px), 2, PARAMETERS))
    for i, camera in enumerate(cameras):
        at = np.flatnonzero(which == i)
        if not len(at):
            continue
        ground[at] = displace_camera(camera, d[i]).row_from_image(px[at])
        for k, step in enumerate(np.eye(PARAMETERS) * _STEP_PX):
            by[at, :, k] = (displace_camera(camera, d[i] + step).row_from_image(px[at]) - ground[at]) / _STEP_PX
    return ground, by


def _turned(motion: Motion, row: Ints, arrows: Floats) -> Floats:
    """Rotate derivatives (k, 2, f), taken in the rows numbered `row` (k,), into board coordinates."""
    return np.stack([motion.turned(row, arrows[:, :, k]) for k in range(arrows.shape[2])], -1)


def _row_jacobian(motion: Motion, row: Ints, ground_mm: Floats) -> Floats:
    """Compute derivatives (k, 2, 3) of board points by their rows' motion (φ, sx, sy): turn, shift x, shift y."""
    arm = motion.turned(row, ground_mm - motion.pivot)
    one, nil = np.ones(len(arm)), np.zeros(len(arm))
    return np.stack([np.stack([-arm[:, 1], one, nil], -1), np.stack([arm[:, 0], nil, one], -1)], 1)
