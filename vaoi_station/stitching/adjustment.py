"""One adjustment of a run: the motion of all rows, and C, from all links and sightings at once.

Unknowns are three per row (φ_j, s_j), four of the similarity C once fiducials are assigned, the
coefficients of the board's surface where it is asked for, and a height for every component that has
links of its own. The paper chains rows (equations 11–16) and adds up their errors; here every link
counts once, robustly, by iteratively reweighted Gauss-Newton.

Heights enter linearly: a ground point moves by its lean per mm. Heights of components are eliminated
from the normal equations (each is tied only to its own links).
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np

from vaoi_station.geometry.robust import huber_weights
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.blocks import Block, belt_block, roots, summed, whitened
from vaoi_station.stitching.motion import SPEED_TOLERANCE, STEP_TOLERANCE, Motion
from vaoi_station.stitching.observations import Ints
from vaoi_station.stitching.problem import Adjusted, FiducialPoints, Problem
from vaoi_station.stitching.scatter import excess

_ITERATIONS = 15
_CONVERGED_MM = 2e-6
_KNEE = 2.0
"""Residuals beyond so many standard deviations lose weight (Huber) …"""
_CUT = 6.0
"""… and beyond so many count no more."""
_PAIR_SIGMA_PX, _PAIR_SHARE = {False: 0.002, True: 0.014}, 0.25
"""What the links of one pair of frames share and does not average out: so many px between rows of one camera
(interpolation), and between two cameras (each has its own light and its own view of what stands a little above the
board), and that share of what they scatter beyond noise."""
_FLOOR_PX = (0.003, 5.0)
"""Range of what single links scatter beyond image noise."""
_SETTLED = 6
"""After so many steps the scatter is left as it is, so that the rest converges."""
_SEAM_PX, _NARROWING = 0.04, 3.0
"""Once a surface can explain what two cameras see, their links are taken to scatter by no more, or by a third of what
they do: the surface follows those that agree, and parts that lean over the board beside them are left behind."""
_HEIGHT_SIGMA_MM = 3.0
_MARK_OWN_PX, _MARK_SHARED_PX = 0.002, 0.004
"""What a sighting of a fiducial is off beyond its own standard deviation: by itself, and in common with all sightings
of the same fiducial (its artwork, the light on it), which does not average out."""
_SCALE_SIGMA = 3e-4
"""How far a board may be shrunk or stretched against its CAD data (1 σ, relative)."""


def adjust(problem: Problem, start: Motion, similarity: Floats | None = None) -> Adjusted:
    """Solve for all unknowns.

    Args:
        problem: observations and priors.
        start: motion to start from; right to a few px.
        similarity: C to start from, where fiducials are given.
    """
    solver = _Solver(problem, start, similarity)
    for _ in range(_ITERATIONS):
        if solver.step() < _CONVERGED_MM:
            break
    return solver.result()


def _mark_sigma_mm(s: FiducialPoints) -> Floats:
    """Standard deviation (s,) of each sighting, such that those of one fiducial are no surer together than that."""
    own = s.sigma_mm**2 + (_MARK_OWN_PX / s.px_per_mm) ** 2
    shared = (_MARK_SHARED_PX / s.px_per_mm) ** 2
    fiducial = s.which >= 0
    count = np.bincount(s.which[fiducial], minlength=1)
    times = np.where(fiducial, count[np.maximum(s.which, 0)], 1)
    return np.asarray(np.sqrt(own + times * shared))


class _Solver:
    def __init__(self, problem: Problem, start: Motion, similarity: Floats | None) -> None:
        self.p = problem
        self.motion = start
        self.c = similarity
        self.m = len(start.angle)
        self.f = problem.surface.at_links.shape[1] if problem.surface else 0
        self.beta = np.zeros(self.f)
        self.same_row = problem.links.p == problem.links.q
        # what a part shows to two cameras at once (its top) and from row to row (its leads, the board between them) may
        # stand at different heights: were they one unknown, the difference would lift the whole board
        self.n_parts = int(problem.component.max(initial=-1)) + 1
        self.n_components = 2 * self.n_parts
        self.component = np.where(self.same_row, problem.component + self.n_parts, problem.component)
        self.component[problem.component < 0] = -1
        self.heights = np.zeros(self.n_components)
        self.floor_px = {False: 0.05, True: 0.05}
        self.size = 3 * self.m + (4 if problem.fiducials else 0) + self.f
        self.tail = np.arange(self.size - self.f, self.size)
        self.pairs = _runs_of_equal(problem.links.p * self.m + problem.links.q)
        self.normal = np.eye(self.size)
        self.steps = 0

    def step(self) -> float:
        """One reweighted Gauss-Newton step; returns the largest change of a shift in mm."""
        self.steps += 1
        self.coupling = np.zeros((self.n_components, self.size))
        self.height_normal = np.full(self.n_components, 1 / _HEIGHT_SIGMA_MM**2)
        self.height_right = -self.heights / _HEIGHT_SIGMA_MM**2
        normal, right = summed([*self._link_blocks(), *self._belt(), *self._fiducials(), *self._surface()], self.size)
        own = self.coupling / self.height_normal[:, None]
        normal -= self.coupling.T @ own
        right -= own.T @ self.height_right
        normal[:3, :] = normal[:, :3] = 0
        normal[:3, :3], right[:3] = np.eye(3), 0
        self.normal = normal
        delta = np.asarray(np.linalg.solve(normal, right), dtype=np.float64)
        self._move(delta)
        self.heights = self.heights + self.height_right / self.height_normal - own @ delta
        return float(np.abs(delta[: 3 * self.m].reshape(-1, 3)[:, 1:]).max())

    def _move(self, delta: Floats) -> None:
        rows = delta[: 3 * self.m].reshape(self.m, 3)
        self.motion = replace(self.motion, angle=self.motion.angle + rows[:, 0], shift=self.motion.shift + rows[:, 1:])
        if self.c is not None:
            self.c = self.c + delta[3 * self.m : 3 * self.m + 4]
        self.beta = self.beta + delta[self.tail]

    def _residuals(self) -> tuple[Floats, Floats]:
        """Misfit (k, 2) mm of every link, and its change per mm of height (k, 2)."""
        o, motion = self.p.links, self.motion
        lean = motion.turned(o.q, o.b_lean) - motion.turned(o.p, o.a_lean)
        return motion.board(o.q, o.b_mm) - motion.board(o.p, o.a_mm) + lean * self._link_height()[:, None], lean

    def _link_height(self) -> Floats:
        h = np.zeros(len(self.p.links))
        if self.p.surface is not None:
            h += self.p.surface.at_links @ self.beta
        if self.n_components:
            on = self.component >= 0
            h[on] += self.heights[self.component[on]]
        return h

    def _weights(self, residual: Floats) -> Floats:
        """Weight matrices (k, 2, 2) mm⁻², robust and with what a pair of frames shares taken into account."""
        o = self.p.links
        floor_px = np.where(self.same_row, self.floor_px[True], self.floor_px[False])
        information = _inverses(o.noise_mm2, (floor_px / o.px_per_mm) ** 2)
        chi = np.sqrt((whitened(roots(information), residual) ** 2).sum(0) / 2)
        self.sigma = chi
        self.robust = np.where(chi > _CUT, 0.0, huber_weights(chi, _KNEE))
        told = self.robust * np.trace(information, axis1=1, axis2=2) / 2
        per_pair = np.bincount(o.group, told, minlength=len(o.groups))
        shared = np.where(self.same_row, _PAIR_SIGMA_PX[True], _PAIR_SIGMA_PX[False])
        shared = np.maximum(shared, _PAIR_SHARE * floor_px) / o.px_per_mm
        share = 1 / (1 + per_pair[o.group] * shared**2)
        return np.asarray(information * (self.robust * share)[:, None, None])

    def _update_floor(self, residual: Floats) -> None:
        """What single links scatter beyond image noise, from those on the bare board, which the model should explain.

        Links between rows and between cameras have each their own: a lifted board first shows as a large
        scatter of the latter, which keeps their weight until the surface explains it.
        """
        if self.steps > _SETTLED:
            return
        o, bare = self.p.links, self.p.component < 0
        noise = o.noise_mm2 * (o.px_per_mm**2)[:, None, None]
        residual = residual * o.px_per_mm[:, None]
        for kind in (False, True):
            at = bare & (self.same_row == kind)
            if at.sum() >= 20:
                self.floor_px[kind] = excess(residual[at], noise[at], *_FLOOR_PX)
        if self.p.surface is not None:
            scatter = self.floor_px[True]
            self.floor_px[True] = max(min(scatter, _SEAM_PX), scatter / _NARROWING)

    def _link_blocks(self) -> list[Block]:
        """One block per pair of rows; what links say of component heights is set aside for elimination."""
        o = self.p.links
        if not len(o):
            return []
        residual, lean = self._residuals()
        self._update_floor(residual)
        root = roots(self._weights(residual))
        parts = [-_row_jacobian(self.motion, o.p, o.a_mm), _row_jacobian(self.motion, o.q, o.b_mm)]
        if self.p.surface is not None:
            parts.append(lean[:, :, None] * self.p.surface.at_links[:, None, :])
        a, b = whitened(root, np.concatenate(parts, 2)), whitened(root, residual)
        self._set_heights_aside(a, b, whitened(root, lean))
        blocks = []
        for at in self.pairs:
            columns = self._columns(int(o.p[at[0]]), int(o.q[at[0]]))
            blocks.append(Block(columns, a[:, at].reshape(-1, a.shape[2]), b[:, at].ravel()))
        return blocks

    def _columns(self, p: int, q: int) -> Ints:
        return np.concatenate([np.arange(3 * p, 3 * p + 3), np.arange(3 * q, 3 * q + 3), self.tail])

    def _set_heights_aside(self, a: Floats, b: Floats, lean: Floats) -> None:
        """Each component's height is tied only to its own links: its row of the normal equations."""
        if not self.n_components:
            return
        o, on = self.p.links, np.flatnonzero(self.component >= 0)
        c = self.component[on]
        lean = lean[:, on]
        self.height_normal += np.bincount(c, (lean**2).sum(0), minlength=self.n_components)
        self.height_right -= np.bincount(c, (lean * b[:, on]).sum(0), minlength=self.n_components)
        cross = (lean[:, :, None] * a[:, on]).sum(0)
        first = np.stack([3 * o.p[on], 3 * o.q[on]], 1)[:, :, None] + np.arange(3)
        columns = np.concatenate([first.reshape(-1, 6), np.repeat(self.tail[None], len(on), 0)], 1)
        flat = (c[:, None] * self.size + columns).ravel()
        sums = np.bincount(flat, cross.ravel(), minlength=self.n_components * self.size)
        self.coupling += sums.reshape(self.n_components, self.size)
        self.coupling[:, :3] = 0

    def _belt(self) -> list[Block]:
        """The conveyor at its mean speed, as measured: rows nobody sees stay where it puts them."""
        if self.m < 2:
            return []
        dt = np.diff(self.p.times_s)
        o = self.p.links
        measured = np.zeros(self.m - 1, dtype=bool)
        for at in self.pairs:
            measured[o.p[at[0]] : o.q[at[0]]] = True
        steps = -np.diff(self.motion.shift, axis=0)[measured] / dt[measured, None]
        prior = STEP_TOLERANCE**2 / SPEED_TOLERANCE**2
        velocity = (steps.sum(0) + prior * self.p.velocity_mm_s) / (len(steps) + prior)
        return [belt_block(self.motion, self.p.times_s, velocity)]

    def _surface(self) -> list[Block]:
        if self.p.surface is None:
            return []
        sigma = self.p.surface.sigma_mm
        return [Block(self.tail, np.diag(1 / sigma), self.beta / sigma)]

    def _fiducials(self) -> list[Block]:
        """Sightings of fiducials, and the scale that CAD data and calibration agree on."""
        s = self.p.fiducials
        if s is None or self.c is None:
            return []
        residual, j = self._fiducial_terms(s)
        sigma = _mark_sigma_mm(s)
        chi = np.sqrt((residual**2).sum(1) / 2) / sigma
        many = s.which < 0
        if many.any():  # while the rows are still where the belt put them, all are far off: none is an outlier yet
            scale = max(float(np.median(chi[many])), 1.0)
            chi, sigma = np.where(many, chi / scale, chi), np.where(many, sigma * scale, sigma)
        robust = np.where(many & (chi > _CUT), 0.0, huber_weights(chi, _KNEE))
        weight = (np.sqrt(robust) / sigma)[:, None]
        tail = np.arange(3 * self.m, self.size)
        a, b = weight[:, :, None] * j, weight * residual
        blocks = [
            Block(
                np.concatenate([np.arange(3 * s.row[at[0]], 3 * s.row[at[0]] + 3), tail]),
                a[at].reshape(-1, a.shape[2]),
                b[at].ravel(),
            )
            for at in _runs_of_equal(s.row)
        ]
        scale = float(np.hypot(*self.c[:2]))
        sigma_scale = _SCALE_SIGMA * self.p.nominal_scale
        gradient = self.c[None, :2] / scale / sigma_scale
        off = np.array([(scale - self.p.nominal_scale) / sigma_scale])
        return [*blocks, Block(np.arange(3 * self.m, 3 * self.m + 2), gradient, off)]

    def _fiducial_terms(self, s: FiducialPoints) -> tuple[Floats, Floats]:
        """Misfit (s, 2) mm of the sightings, and its Jacobian for row, C and surface (s, 2, 3 + 4 + f)."""
        assert self.c is not None
        height = self.p.surface.at_fiducials @ self.beta if self.p.surface else np.zeros(len(s.row))
        lean = self.motion.turned(s.row, s.lean)
        residual = self.motion.board(s.row, s.ground_mm) + lean * height[:, None] - similar(self.c, s.cad)
        parts = [_row_jacobian(self.motion, s.row, s.ground_mm), -similar_jacobian(s.cad)]
        if self.p.surface is not None:
            parts.append(lean[:, :, None] * self.p.surface.at_fiducials[:, None, :])
        return residual, np.concatenate(parts, 2)

    def result(self) -> Adjusted:
        o, s = self.p.links, self.p.fiducials
        covariance = np.asarray(np.linalg.inv(self.normal), dtype=np.float64)
        covariance[:3] = covariance[:, :3] = 0
        used, sigma, px = np.zeros(0), np.zeros(0), np.zeros((0, 2))
        sigma0 = 1.0
        if len(o):
            residual, _ = self._residuals()
            self._weights(residual)
            used, sigma = self.robust, self.sigma
            px = residual * o.px_per_mm[:, None]
            sigma0 = float(np.sqrt(np.average(sigma**2, weights=np.maximum(used, 1e-9))))
        on = self.component >= 0
        told = np.bincount(self.component[on], used[on] > 0.1, minlength=self.n_components) >= 3
        heights = np.where(told, self.heights, np.nan).reshape(2, self.n_parts)
        fiducial_px = np.zeros((0, 2))
        if s is not None and self.c is not None:
            fiducial_px = self._fiducial_terms(s)[0] * s.px_per_mm[:, None]
        return Adjusted(
            self.motion,
            self.c,
            self.beta,
            heights,
            covariance,
            sigma,
            px,
            used,
            fiducial_px,
            self.floor_px[False],
            sigma0,
        )


def similar(c: Floats, cad: Floats) -> Floats:
    """Board points of CAD points (k, 2) by the similarity (a, b, x, y)."""
    a, b, x, y = c
    return np.stack([a * cad[:, 0] - b * cad[:, 1] + x, b * cad[:, 0] + a * cad[:, 1] + y], -1)


def similar_jacobian(cad: Floats) -> Floats:
    """Derivative (k, 2, 4) of `similar` by (a, b, x, y)."""
    x, y, one, nil = cad[:, 0], cad[:, 1], np.ones(len(cad)), np.zeros(len(cad))
    return np.stack([np.stack([x, -y, one, nil], -1), np.stack([y, x, nil, one], -1)], 1)


def _row_jacobian(motion: Motion, row: Ints, ground_mm: Floats) -> Floats:
    """Derivative (k, 2, 3) of a board point by (φ, sx, sy) of its row."""
    arm = motion.turned(row, ground_mm - motion.pivot)
    one, nil = np.ones(len(arm)), np.zeros(len(arm))
    return np.stack([np.stack([-arm[:, 1], one, nil], -1), np.stack([arm[:, 0], nil, one], -1)], 1)


def _runs_of_equal(values: Ints) -> list[Ints]:
    """Positions of equal values, one array per value."""
    if not len(values):
        return []
    order = np.argsort(values, kind="stable")
    return np.split(order, np.flatnonzero(np.diff(values[order])) + 1)


def _inverses(noise: Floats, floor: Floats) -> Floats:
    """Inverse (k, 2, 2) of noise (k, 2, 2) + floor (k,) · 1."""
    a, b, d = noise[:, 0, 0] + floor, noise[:, 0, 1], noise[:, 1, 1] + floor
    out = np.stack([np.stack([d, -b], -1), np.stack([-b, a], -1)], 1)
    return np.asarray(out / (a * d - b * b)[:, None, None])
