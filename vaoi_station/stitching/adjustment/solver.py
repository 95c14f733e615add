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
from numpy.typing import NDArray

from vaoi_station.geometry.robust import huber_weights
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.envelope import Envelope, add, factor, hold_first_row, inverse, of_rows, solve
from vaoi_station.stitching.adjustment.link_equations import (
    Coupling,
    accumulate,
    eliminate,
    heights_moved,
    misfits,
    weigh,
)
from vaoi_station.stitching.adjustment.motion import SPEED_TOLERANCE, STEP_TOLERANCE, Motion
from vaoi_station.stitching.adjustment.noise_floor import noise_floor
from vaoi_station.stitching.adjustment.normal_blocks import belt_steps
from vaoi_station.stitching.adjustment.observations import Ints, Observations
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, FiducialPoints, Problem

_ITERATIONS = 15
CONVERGED_MM = 5e-5
_ENOUGH, _ROUGHLY_MM = 100, 3e-3
"""So many links per row are enough at first, until a step moves no row by more; what is left is a tenth of that."""
_KNEE = 2.0
"""Residuals beyond so many standard deviations lose weight (Huber) …"""
_CUT = 6.0
"""… and beyond so many count no more."""
_PAIR_SIGMA_PX, _PAIR_SHARE = (0.002, 0.014), 0.25
"""What the links of one pair of frames share and does not average out: so many px between rows of one camera
(interpolation), and between two cameras (each has its own light and its own view of what stands a little above the
board), and that share of what they scatter beyond noise."""
_FLOOR_PX = (0.003, 5.0)
"""Range of what single links scatter beyond image noise."""
_TELLING = 4000
"""So many links of a kind tell what it scatters to some 2 %; of more only some are asked."""
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


Equations = tuple[Ints, Floats, Floats]
"""Columns (k, f) of the unknowns, and whitened a (k, r, f) and b (k, r): a·δ + b ≈ 0."""


def adjust(
    problem: Problem, start: Motion, similarity: Floats | None = None, *, converged_mm: float = CONVERGED_MM
) -> AdjustmentResult:
    """Solve for all unknowns.

    Args:
        problem: observations and priors.
        start: motion to start from; right to a few px.
        similarity: C to start from, where fiducials are given.
        converged_mm: a step that moves no row by more is the last one; what is left is a tenth of that.
    """
    solver = _Solver(problem, start, similarity)
    solver.run(converged_mm)
    return solver.result()


def solve_subsampled(problem: Problem, start: Motion) -> Motion | None:
    """The motion to a thousandth of a millimetre by some of the links where they are many; None where they are few."""
    every = len(problem.links) // (_ENOUGH * len(start.angle))
    if every < 2:
        return None
    some = np.flatnonzero(_rank(problem.links.group) % every == 0)
    solver = _Solver(replace(problem, links=problem.links.of(some), component=problem.component[some]), start, None)
    solver.run(_ROUGHLY_MM)
    return solver.motion


def evaluate_at(problem: Problem, motion: Motion) -> AdjustmentResult:
    """All links as a motion leaves them, taken for the solution: its covariance is not known, and 0."""
    return _Solver(problem, motion, None).result()


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
        self.basis = problem.surface.at_links if problem.surface else np.zeros((len(problem.links), 0))
        self.f = self.basis.shape[1]
        self.beta = np.zeros(self.f)
        self.kind = (problem.links.p == problem.links.q).astype(np.int_)
        """0: from row to row; 1: between two cameras in one row."""
        # what a part shows to two cameras at once (its top) and from row to row (its leads, the board between them) may
        # stand at different heights: were they one unknown, the difference would lift the whole board
        self.n_parts = int(problem.component.max(initial=-1)) + 1
        self.n_components = 2 * self.n_parts
        self.component = np.where(problem.component < 0, -1, problem.component + self.n_parts * self.kind)
        self.heights = np.zeros(self.n_components)
        self.floor_px = np.array([0.05, 0.05])
        o, k = problem.links, len(problem.links)
        self.tail = np.arange(3 * self.m, 3 * self.m + (4 if problem.fiducials else 0) + self.f)
        self.coupling = Coupling.of(self.component, o.p, o.q, self.n_components, self.f)
        self.envelope = _envelope(o, self.coupling, self.m, len(self.tail))
        self.factor = np.zeros(0)
        self.residual, self.lean = np.zeros((k, 2)), np.zeros((k, 2))
        self.sigma, self.robust, self.weight = np.zeros(k), np.zeros(k), np.zeros((k, 3))
        self.tied = _tied_steps(problem.links, self.m)
        bare = [np.flatnonzero((problem.component < 0) & (self.kind == kind)) for kind in (0, 1)]
        # contiguous: for a slice with a step another variant would be compiled, while a board waits
        self.telling = [np.ascontiguousarray(links[:: max(len(links) // _TELLING, 1)]) for links in bare]
        """Links on the bare board, from row to row and between cameras, that tell how much links scatter."""
        self.steps = 0

    def run(self, converged_mm: float) -> None:
        """Step until a step moves no row by more."""
        for _ in range(_ITERATIONS):
            if self.step() < converged_mm:
                break

    def step(self) -> float:
        """One reweighted Gauss-Newton step; returns the largest change of a shift in mm."""
        self.steps += 1
        envelope, tied = self.envelope, self.coupling
        values, right = np.zeros(envelope.entries), np.zeros(envelope.size)
        coupling = np.zeros(int(tied.at[-1]))
        height_normal = np.full(self.n_components, 1 / _HEIGHT_SIGMA_MM**2)
        height_right = -self.heights / _HEIGHT_SIGMA_MM**2
        for equations in (self._belt(), *self._fiducials(), self._surface()):
            add(*equations, envelope.at, values, right)
        self._look_at_links()
        self._update_floor()
        self._weigh_links()
        o = self.p.links
        accumulate(
            *(o.p, o.q, o.a_mm, o.b_mm, o.group, self.motion.angle, self.motion.pivot),
            *(self.residual, self.lean, self.weight, self.basis, self.component),
            *(envelope.at, values, right),
            *(tied.row, tied.at),
            *(coupling, height_normal, height_right),
        )
        heights = (tied.row, tied.at, self.f, coupling, height_normal, height_right)
        eliminate(*heights, envelope.at, values, right)
        hold_first_row(envelope.first, envelope.at, values, right)
        factor(envelope.first, envelope.at, values)
        delta = solve(envelope.first, envelope.at, values, right)
        self.factor = values
        self._move(delta)
        self.heights = self.heights + heights_moved(*heights, delta)
        return float(np.abs(delta[: 3 * self.m].reshape(-1, 3)[:, 1:]).max())

    def _move(self, delta: Floats) -> None:
        rows = delta[: 3 * self.m].reshape(self.m, 3)
        self.motion = replace(self.motion, angle=self.motion.angle + rows[:, 0], shift=self.motion.shift + rows[:, 1:])
        if self.c is not None:
            self.c = self.c + delta[3 * self.m : 3 * self.m + 4]
        self.beta = self.beta + delta[len(delta) - self.f :]

    def _look_at_links(self) -> None:
        """Misfit (k, 2) mm of every link, and its change per mm of height (k, 2)."""
        o, motion = self.p.links, self.motion
        height = self.basis @ self.beta + np.append(self.heights, 0.0)[self.component]
        misfits(
            *(o.p, o.q, o.a_mm, o.b_mm, o.a_lean, o.b_lean, height),
            *(motion.angle, motion.shift, motion.pivot, self.residual, self.lean),
        )

    def _weigh_links(self) -> None:
        """Robust weights, with what a pair of frames shares taken into account."""
        o = self.p.links
        shared_px = np.maximum(_PAIR_SIGMA_PX, _PAIR_SHARE * self.floor_px)
        weigh(
            *(self.residual, o.noise_mm2, o.px_per_mm, o.group, len(o.groups), self.kind, self.floor_px, shared_px),
            *(_KNEE, _CUT, self.sigma, self.robust, self.weight),
        )

    def _update_floor(self) -> None:
        """What single links scatter beyond image noise, from those on the bare board, which the model should explain.

        Links between rows and between cameras have each their own: a lifted board first shows as a large
        scatter of the latter, which keeps their weight until the surface explains it.
        """
        if self.steps > _SETTLED:
            return
        o = self.p.links
        for kind, at in enumerate(self.telling):
            if len(at) >= 20:
                self.floor_px[kind] = noise_floor(self.residual, o.noise_mm2, o.px_per_mm, at, *_FLOOR_PX)
        if self.p.surface is not None:
            scatter = self.floor_px[1]
            self.floor_px[1] = max(min(scatter, _SEAM_PX), scatter / _NARROWING)

    def _belt(self) -> Equations:
        """The conveyor at its mean speed, as measured: rows nobody sees stay where it puts them."""
        velocity = self.p.velocity_mm_s
        if self.m > 1:
            dt = np.diff(self.p.times_s)
            steps = -np.diff(self.motion.shift, axis=0)[self.tied] / dt[self.tied, None]
            prior = STEP_TOLERANCE**2 / SPEED_TOLERANCE**2
            velocity = (steps.sum(0) + prior * velocity) / (len(steps) + prior)
        return belt_steps(self.motion, self.p.times_s, velocity)

    def _surface(self) -> Equations:
        """That a board is hardly lifted, tilted and bent."""
        sigma = self.p.surface.sigma_mm if self.p.surface else np.ones(0)
        return self.tail[None, len(self.tail) - self.f :], np.diag(1 / sigma)[None], (self.beta / sigma)[None]

    def _fiducials(self) -> list[Equations]:
        """Detections of fiducials, and the scale that CAD data and calibration agree on."""
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
        columns = np.concatenate(
            [3 * s.row[:, None] + np.arange(3), np.broadcast_to(self.tail, (len(s.row), len(self.tail)))], 1
        )
        scale = float(np.hypot(*self.c[:2]))
        sigma_scale = _SCALE_SIGMA * self.p.nominal_scale
        gradient = self.c[None, None, :2] / scale / sigma_scale
        off = np.array([[(scale - self.p.nominal_scale) / sigma_scale]])
        return [(columns, weight[:, :, None] * j, weight * residual), (self.tail[None, :2], gradient, off)]

    def _fiducial_terms(self, s: FiducialPoints) -> tuple[Floats, Floats]:
        """Misfit (s, 2) mm of the sightings, and its Jacobian for row, C and surface (s, 2, 3 + 4 + f)."""
        assert self.c is not None
        height = self.p.surface.at_fiducials @ self.beta if self.p.surface else np.zeros(len(s.row))
        lean = self.motion.turned(s.row, s.lean)
        residual = self.motion.board(s.row, s.ground_mm) + lean * height[:, None] - apply_similarity(self.c, s.cad)
        parts = [_row_jacobian(self.motion, s.row, s.ground_mm), -similarity_jacobian(s.cad)]
        if self.p.surface is not None:
            parts.append(lean[:, :, None] * self.p.surface.at_fiducials[:, None, :])
        return residual, np.concatenate(parts, 2)

    def result(self) -> AdjustmentResult:
        o, s = self.p.links, self.p.fiducials
        envelope = self.envelope
        covariance = np.zeros((self.m, 3 + len(self.tail), 3 + len(self.tail)))
        if self.steps:
            covariance = of_rows(envelope, inverse(envelope.first, envelope.at, envelope.rows, self.factor))
            covariance[0, :3] = covariance[0, :, :3] = 0
        self._look_at_links()
        self._weigh_links()
        px = self.residual * o.px_per_mm[:, None]
        sigma0 = 1.0
        if len(o):
            sigma0 = float(np.sqrt(np.average(self.sigma**2, weights=np.maximum(self.robust, 1e-9))))
        on = self.component >= 0
        told = np.bincount(self.component[on], self.robust[on] > 0.1, minlength=self.n_components) >= 3
        heights = np.where(told, self.heights, np.nan).reshape(2, self.n_parts)
        fiducial_px = np.zeros((0, 2))
        if s is not None and self.c is not None:
            fiducial_px = self._fiducial_terms(s)[0] * s.px_per_mm[:, None]
        return AdjustmentResult(
            self.motion,
            self.c,
            self.beta,
            heights,
            covariance,
            self.sigma,
            px,
            self.robust,
            fiducial_px,
            float(self.floor_px[0]),
            sigma0,
        )


def apply_similarity(c: Floats, cad: Floats) -> Floats:
    """Board points of CAD points (k, 2) by the similarity (a, b, x, y)."""
    a, b, x, y = c
    return np.stack([a * cad[:, 0] - b * cad[:, 1] + x, b * cad[:, 0] + a * cad[:, 1] + y], -1)


def similarity_jacobian(cad: Floats) -> Floats:
    """Derivative (k, 2, 4) of `apply_similarity` by (a, b, x, y)."""
    x, y, one, nil = cad[:, 0], cad[:, 1], np.ones(len(cad)), np.zeros(len(cad))
    return np.stack([np.stack([x, -y, one, nil], -1), np.stack([y, x, nil, one], -1)], 1)


def _row_jacobian(motion: Motion, row: Ints, ground_mm: Floats) -> Floats:
    """Derivative (k, 2, 3) of a board point by (φ, sx, sy) of its row."""
    arm = motion.turned(row, ground_mm - motion.pivot)
    one, nil = np.ones(len(arm)), np.zeros(len(arm))
    return np.stack([np.stack([-arm[:, 1], one, nil], -1), np.stack([arm[:, 0], nil, one], -1)], 1)


def _envelope(links: Observations, coupling: Coupling, rows: int, others: int) -> Envelope:
    """Rows share what the belt says of two that follow one another, links, and the components that they see."""
    furthest, first = np.minimum(np.arange(rows) + 1, rows - 1), _begins(links.group)
    p, q = links.p[first], links.q[first]
    np.maximum.at(furthest, np.minimum(p, q), np.maximum(p, q))
    np.maximum.at(furthest, coupling.row, coupling.last)
    return Envelope.of(furthest, others)


def _rank(group: Ints) -> Ints:
    """(k,) the how manieth of its group each link is; groups stand together."""
    begins = _begins(group)
    return np.arange(len(group)) - np.repeat(begins, np.diff(begins, append=len(group)))


def _begins(group: Ints) -> Ints:
    """Where each group of links begins; those of one are all between the same two rows."""
    return np.flatnonzero(np.diff(group, prepend=-1))


def _tied_steps(links: Observations, rows: int) -> NDArray[np.bool_]:
    """Which steps (rows − 1,) from row to row some link spans."""
    change = np.bincount(links.p, minlength=rows) - np.bincount(links.q, minlength=rows)
    return np.asarray(np.cumsum(change)[:-1] > 0)
