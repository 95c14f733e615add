"""Adjust a run: the motion of all rows, and C, from all links and detections at once.

Unknowns are three per row (φ_j, s_j), four of the similarity C once fiducials are assigned, the
coefficients of the board's surface where one is requested, and a height for every component that has
links of its own. The paper chains rows (equations 11–16), which adds up their errors; here every link
counts once, robustly, by iteratively reweighted Gauss-Newton.

Heights enter linearly: a ground point moves by its lean per mm. Heights of components are eliminated
from the normal equations, because each is coupled to its own links only.
"""

from __future__ import annotations

from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.envelope import (
    Envelope,
    NormalEquations,
    add_equations,
    factorise,
    hold_first_row,
    inverse,
    row_blocks,
    solve,
)
from vaoi_station.stitching.adjustment.fiducial_equations import (
    Equations,
    detection_equations,
    fiducial_residuals,
    scale_equation,
)
from vaoi_station.stitching.adjustment.link_equations import (
    Coupling,
    HeightEquations,
    HeightModel,
    LinkState,
    MotionArrays,
    NoiseModel,
    add_links,
    compute_residuals,
    compute_weights,
    eliminate_heights,
    height_changes,
)
from vaoi_station.stitching.adjustment.motion import SPEED_TOLERANCE, STEP_TOLERANCE, Motion
from vaoi_station.stitching.adjustment.noise_floor import noise_floor
from vaoi_station.stitching.adjustment.normal_blocks import belt_steps
from vaoi_station.stitching.adjustment.observations import Ints, Observations
from vaoi_station.stitching.adjustment.problem import AdjustmentResult, Problem

_MAX_STEPS = 15
CONVERGED_MM = 5e-5
"""The last step moves no row by more; as steps shrink tenfold, about a tenth of it remains."""
_SAMPLE_PER_ROW, _SAMPLE_CONVERGED_MM = 100, 3e-3
"""Links per row in a subsampled solution, and its `CONVERGED_MM`."""
_KNEE, _CUT = 2.0, 6.0
"""Standard deviations beyond which a residual loses weight (Huber), and beyond which it has none."""
_PAIR_SIGMA_PX, _PAIR_SHARE = (0.002, 0.014), 0.25
"""Error that the links of one pair of frames share, which does not average out: a constant in px, between rows of one
camera (interpolation) and between two cameras (each with its own light and its own perspective of what stands a little
above the board), and at least this share of the noise floor."""
_FLOOR_PX = (0.003, 5.0)
"""Limits of the noise floor of links."""
_FLOOR_SAMPLE, _FLOOR_MIN_LINKS = 4000, 20
"""Links of a kind from which the noise floor is estimated, to some 2 %, and the fewest that allow an estimate."""
_FLOOR_STEPS = 6
"""The noise floor is constant after this number of steps, so that the remaining steps converge."""
_SEAM_PX, _NARROWING = 0.04, 3.0
"""Limits of the noise floor between two cameras once a surface is estimated: in px, and as a divisor of the scatter.
The surface then follows the links that agree; parts that lean over the board beside the seam become outliers."""
_HEIGHT_SIGMA_MM = 3.0
"""Prior of a component's height."""
_USED_WEIGHT, _HEIGHT_MIN_LINKS = 0.1, 3
"""A component's height is reported with this number of links above this robust weight."""


def adjust(
    problem: Problem, start: Motion, similarity: Floats | None = None, *, converged_mm: float = CONVERGED_MM
) -> AdjustmentResult:
    """Solve for all unknowns.

    Args:
        problem: observations and priors.
        start: motion to start from; right to a few px.
        similarity: C to start from, where fiducials are given.
        converged_mm: a step that moves no row by more is the last one; about a tenth of that remains.
    """
    solver = _Solver(problem, start, similarity)
    solver.run(converged_mm)
    return solver.result()


def solve_subsampled(problem: Problem, start: Motion) -> Motion | None:
    """Estimate the motion to a thousandth of a millimetre from a subsample of the links; None where they are few."""
    every = len(problem.links) // (_SAMPLE_PER_ROW * len(start.angle))
    if every < 2:
        return None
    # every n-th link of each pair of frames, not of all links: no pair may be left without any
    some = np.flatnonzero(_index_in_group(problem.links.group) % every == 0)
    sample = replace(problem, links=problem.links.select(some), component=problem.component[some])
    solver = _Solver(sample, start, None)
    solver.run(_SAMPLE_CONVERGED_MM)
    return solver.motion


def evaluate_at(problem: Problem, motion: Motion) -> AdjustmentResult:
    """Evaluate all links at a motion that is taken as the solution; its covariance is not computed, and 0."""
    return _Solver(problem, motion, None).result()


class _Solver:
    """The unknowns of one adjustment and the arrays of its steps."""

    def __init__(self, problem: Problem, start: Motion, similarity: Floats | None) -> None:
        self.problem = problem
        self.motion = start
        self.similarity = similarity
        links, surface = problem.links, problem.surface
        self.rows = len(start.angle)
        basis = surface.at_links if surface else np.zeros((len(links), 0))
        self.n_surface = basis.shape[1]
        self.surface_mm = np.zeros(self.n_surface)
        self.kind = (links.p == links.q).astype(np.int_)
        """0: from row to row; 1: between two cameras in one row."""
        # what a part shows to two cameras at once (its top) and from row to row (its leads, the board between them) may
        # stand at different heights: were they one unknown, the difference would lift the whole board
        self.n_parts = int(problem.component.max(initial=-1)) + 1
        component = np.where(problem.component < 0, -1, problem.component + self.n_parts * self.kind)
        self.heights_mm = np.zeros(2 * self.n_parts)
        self.model = HeightModel(basis, component)
        # a start of the order of the real floor: the first weights need one before any estimate
        self.floor_px = np.array([0.05, 0.05])
        others = (4 if problem.fiducials else 0) + self.n_surface
        self.others = np.arange(3 * self.rows, 3 * self.rows + others)
        """Columns of C and the surface."""
        self.coupling = Coupling.of(component, links.p, links.q, 2 * self.n_parts, self.n_surface)
        self.envelope = _envelope(links, self.coupling, self.rows, others)
        self.factor: NormalEquations | None = None
        self.state = LinkState.zeros(len(links))
        self.linked_steps = _linked_steps(links, self.rows)
        bare = [np.flatnonzero((problem.component < 0) & (self.kind == kind)) for kind in (0, 1)]
        # contiguous: for a slice with a step another variant would be compiled, while a board waits
        self.floor_samples = [np.ascontiguousarray(at[:: max(len(at) // _FLOOR_SAMPLE, 1)]) for at in bare]
        """Links on the bare board, by kind: the model explains them, so that what remains is noise."""
        self.steps = 0

    def run(self, converged_mm: float) -> None:
        """Step until a step moves no row by more."""
        for _ in range(_MAX_STEPS):
            if self.step() < converged_mm:
                break

    def step(self) -> float:
        """Make one reweighted Gauss-Newton step; return the largest change of a shift in mm."""
        self.steps += 1
        normal = self.envelope.zeros()
        heights = self.coupling.equations(self.heights_mm, _HEIGHT_SIGMA_MM)
        for equations in (self._belt(), *self._fiducials(), self._surface()):
            add_equations(*equations, normal)
        self._compute_residuals()
        # the noise floor needs residuals and weights need the noise floor
        self._update_noise_floor()
        self._compute_weights()
        add_links(self.problem.links.arrays, self._motion_arrays(), self.model, self.state, heights, normal)
        eliminate_heights(heights, normal)
        hold_first_row(normal)
        factorise(normal)
        self.factor = normal
        return self._move(solve(normal), heights)

    def _move(self, delta: Floats, heights: HeightEquations) -> float:
        """Change all unknowns; return the largest change of a shift in mm."""
        rows = delta[: 3 * self.rows].reshape(self.rows, 3)
        self.motion = replace(self.motion, angle=self.motion.angle + rows[:, 0], shift=self.motion.shift + rows[:, 1:])
        if self.similarity is not None:
            self.similarity = self.similarity + delta[3 * self.rows : 3 * self.rows + 4]
        self.surface_mm = self.surface_mm + delta[len(delta) - self.n_surface :]
        self.heights_mm = self.heights_mm + height_changes(heights, delta)
        return float(np.abs(rows[:, 1:]).max())

    def _motion_arrays(self) -> MotionArrays:
        return MotionArrays(self.motion.angle, self.motion.shift, self.motion.pivot)

    def _compute_residuals(self) -> None:
        """Compute the residual of every link at the current unknowns."""
        height = self.model.basis @ self.surface_mm + np.append(self.heights_mm, 0.0)[self.model.component]
        compute_residuals(self.problem.links.arrays, self._motion_arrays(), height, self.state)

    def _compute_weights(self) -> None:
        """Compute robust weights at the current residuals and noise floor."""
        links = self.problem.links
        shared_px = np.maximum(_PAIR_SIGMA_PX, _PAIR_SHARE * self.floor_px)
        noise = NoiseModel(self.kind, self.floor_px, shared_px, _KNEE, _CUT)
        compute_weights(links.arrays, noise, len(links.groups), self.state)

    def _update_noise_floor(self) -> None:
        """Estimate the scatter of links beyond image noise from those on the bare board.

        Links between rows and between cameras have separate floors: a lifted board first appears as a large
        scatter of the latter, which keeps the weight of the former until the surface explains it.
        """
        if self.steps > _FLOOR_STEPS:
            return
        links = self.problem.links
        for kind, at in enumerate(self.floor_samples):
            if len(at) >= _FLOOR_MIN_LINKS:
                self.floor_px[kind] = noise_floor(self.state.residual, links.noise_mm2, links.px_per_mm, at, *_FLOOR_PX)
        if self.problem.surface is not None:
            scatter = self.floor_px[1]
            self.floor_px[1] = max(min(scatter, _SEAM_PX), scatter / _NARROWING)

    def _belt(self) -> Equations:
        """Return the prior of every step: the conveyor at its mean measured speed, which places rows without links."""
        problem, velocity = self.problem, self.problem.velocity_mm_s
        if self.rows > 1:
            dt = np.diff(problem.times_s)
            steps = -np.diff(self.motion.shift, axis=0)[self.linked_steps] / dt[self.linked_steps, None]
            # weighted mean of the steps and the nominal speed, each with its own variance
            prior = STEP_TOLERANCE**2 / SPEED_TOLERANCE**2
            velocity = (steps.sum(0) + prior * velocity) / (len(steps) + prior)
        return belt_steps(self.motion, problem.times_s, velocity)

    def _surface(self) -> Equations:
        """Return the prior of the surface: a board is hardly lifted, tilted and bent."""
        sigma = self.problem.surface.sigma_mm if self.problem.surface else np.ones(0)
        columns = self.others[None, len(self.others) - self.n_surface :]
        return columns, np.diag(1 / sigma)[None], (self.surface_mm / sigma)[None]

    def _fiducials(self) -> list[Equations]:
        """Return the equations of detections of fiducials and of the scale."""
        points, c = self.problem.fiducials, self.similarity
        if points is None or c is None:
            return []
        detections = detection_equations(points, *self._fiducial_residuals(c), self.others)
        return [detections, scale_equation(c, self.problem.nominal_scale, self.others[:2])]

    def _fiducial_residuals(self, c: Floats) -> tuple[Floats, Floats]:
        """Return residuals and Jacobian of the detections at the current unknowns."""
        points, surface = self.problem.fiducials, self.problem.surface
        assert points is not None
        basis = surface.at_fiducials if surface else np.zeros((len(points.row), 0))
        return fiducial_residuals(points, self.motion, c, basis, self.surface_mm)

    def result(self) -> AdjustmentResult:
        """Return the current unknowns with residuals and weights of all links."""
        self._compute_residuals()
        self._compute_weights()
        links, state, points = self.problem.links, self.state, self.problem.fiducials
        sigma0 = 1.0
        if len(links):
            # the bound keeps the average defined where no link has any weight
            sigma0 = float(np.sqrt(np.average(state.sigma**2, weights=np.maximum(state.robust, 1e-9))))
        fiducial_px = np.zeros((0, 2))
        if points is not None and self.similarity is not None:
            fiducial_px = self._fiducial_residuals(self.similarity)[0] * points.px_per_mm[:, None]
        return AdjustmentResult(
            self.motion,
            self.similarity,
            self.surface_mm,
            self._reported_heights(),
            self._covariance(),
            state.sigma,
            state.residual * links.px_per_mm[:, None],
            state.robust,
            fiducial_px,
            float(self.floor_px[0]),
            sigma0,
        )

    def _covariance(self) -> Floats:
        """Return the covariance (m, u, u) of each row with C and the surface; 0 before the first step."""
        size = 3 + len(self.others)
        covariance = np.zeros((self.rows, size, size))
        if self.factor is not None:
            covariance = row_blocks(self.envelope, inverse(self.factor, self.rows))
            # row 0 is held: its lines are those of the identity, not a covariance
            covariance[0, :3] = covariance[0, :, :3] = 0
        return covariance

    def _reported_heights(self) -> Floats:
        """Return the heights (2, parts), NaN where too few links determine them."""
        component = self.model.component
        on = component >= 0
        used = np.bincount(component[on], self.state.robust[on] > _USED_WEIGHT, minlength=2 * self.n_parts)
        return np.where(used >= _HEIGHT_MIN_LINKS, self.heights_mm, np.nan).reshape(2, self.n_parts)


def _envelope(links: Observations, coupling: Coupling, rows: int, others: int) -> Envelope:
    """Build the envelope: rows share the belt's steps, links, and the components that they see."""
    furthest, first = np.minimum(np.arange(rows) + 1, rows - 1), _begins(links.group)
    p, q = links.p[first], links.q[first]
    np.maximum.at(furthest, np.minimum(p, q), np.maximum(p, q))
    np.maximum.at(furthest, coupling.row, coupling.last)
    return Envelope.of(furthest, others)


def _index_in_group(group: Ints) -> Ints:
    """Return the index (k,) of each link within its group; links of one group are adjacent."""
    begins = _begins(group)
    return np.arange(len(group)) - np.repeat(begins, np.diff(begins, append=len(group)))


def _begins(group: Ints) -> Ints:
    """Return the index of the first link of each group; all links of a group have the same two rows."""
    return np.flatnonzero(np.diff(group, prepend=-1))


def _linked_steps(links: Observations, rows: int) -> NDArray[np.bool_]:
    """Return which steps (rows − 1,) from row to row are spanned by a link."""
    change = np.bincount(links.p, minlength=rows) - np.bincount(links.q, minlength=rows)
    return np.asarray(np.cumsum(change)[:-1] > 0)
