"""Adjust a run: estimate the motion of all rows and C together, from all links and detections.

The unknowns are (φ_j, s_j) of every row j, the four numbers of the similarity C once fiducials are assigned, the
coefficients of the surface if one is requested, the heights of the components on which links lie, and the displacements
of the cameras against their calibration. The paper chains the rows (equations 11–16), so that their errors add up. Here
all links are used together, in a robust least-squares solution by iteratively reweighted Gauss-Newton.

The equations are linear in the heights: a ground point moves by its lean per mm of height. The heights of components
are eliminated from the normal equations, because each of them occurs only in the links that lie on the component.

Estimate the noise floor of measurements: by how much they scatter beyond their stated noise.
"""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.cameras import MovingCameras, row_changes
from vaoi_station.stitching.adjustment.envelope import (
    NormalEquations,
    factorise,
    hold_first_row,
    inverse,
    row_blocks,
    solve_backward,
)
from vaoi_station.stitching.adjustment.equations import (
    Coupling,
    Equations,
    HeightEquations,
    HeightModel,
    HeightScatter,
    LinkModel,
    LinkState,
    MotionArrays,
    NoiseModel,
    OtherColumns,
    compute_residuals,
    compute_weights,
    detection_equations,
    eliminate_heights,
    fiducial_residuals,
    height_changes,
    scale_equation,
)
from vaoi_station.stitching.adjustment.influence import Assembly, examine_influence
from vaoi_station.stitching.adjustment.motion import (
    SPEED_TOLERANCE,
    STEP_TOLERANCE,
    Motion,
    belt_equations,
    let_irregular_steps_free,
)
from vaoi_station.stitching.adjustment.problem import (
    USED,
    AdjustmentResult,
    Influence,
    Ints,
    Problem,
    index_in_group,
    linked_steps,
    median_noise_px,
    prior_sigma_mm,
)

_MEDIAN = 2 * math.log(2)
"""Median of the χ² distribution with two degrees of freedom."""
_HALVINGS = 12
"""Number of bisections. With limits of 0.003 and 5 px, the result is uncertain by 0.2 %."""

_LIMITS_PX, _FIRST_PX = (0.003, 5.0), 0.05
"""Smallest and largest noise floor of links, px, and a usual value, used until the noise floor is estimated."""
_AT_LIMIT, _DISPLACED_PX = 0.99, 60.0
"""Two values for the noise floor between two cameras whose displacements are unknowns.
The noise floor counts as limited if it exceeds this share of its upper limit. It is then estimated with the second
value as upper limit. A turn of a camera by 0.1° causes a displacement of some 35 px, which is below this limit: with a
lower one, all links of the camera would be rejected before its displacement is estimated."""
_SAMPLE, _MIN_LINKS, _SEAM_LINKS = 4000, 20, 6
"""The noise floor of a kind of link is estimated from about `_SAMPLE` links, which gives it to about 2 %.
It needs at least `_MIN_LINKS` links; `_SEAM_LINKS` between two cameras can only raise it. Otherwise all links of a
displaced camera would be rejected where the overlap shows few."""
_FEW = 60
"""With fewer links between rows on the bare board, more than half of them may be false ones at the board's edges.

The noise floor is then at most that of all links between rows, which is never too small: heights scatter."""
_SEAM_PX, _NARROWING = 0.04, 3.0
"""Upper limit of the noise floor between two cameras if a surface is estimated.
It is `_SEAM_PX`, or the scatter divided by `_NARROWING`, whichever is larger. So the surface follows those links that
agree with one another. Links on tall components beside the seam become outliers."""


class NoiseFloors:
    """The noise floors of the links of a problem, one for each kind of link.

    Each pair of neighbouring cameras is a kind of its own. A lifted board or a displaced camera at first causes a large
    scatter, but only in the links between the cameras concerned. All other links keep their weight until the surface
    and the displacements explain this scatter.
    """

    def __init__(self, problem: Problem, kind: Ints, seams: int, raised: NDArray[np.bool_]) -> None:
        """Choose the links from which the noise floors are estimated.

        Args:
            kind: (k,) kind of each link: 0 between rows, 1 … `seams` between two cameras in one row, and the last one
                between rows of different lights.
            seams: number of kinds of links between two cameras.
            raised: (k,) whether each link may lie above the board although no component is under it.
        """
        self._problem, self._seams = problem, seams
        bare = [_bare(problem, kind == k, raised) for k in range(1 + seams + 1)]
        self._samples = [_sample(at) for at in bare]
        """Indices of sampled links on the bare board, by kind. The model explains these links: what is left is noise.
        """
        rows = np.flatnonzero(kind == 0)
        self._all_rows = _sample(rows if len(bare[0]) < _FEW else rows[:0])
        """Indices of sampled links between rows, if those on the bare board are few."""
        self.noise_px = np.array([median_noise_px(problem.links, at) for at in self._samples])
        """Median image noise of the sampled links, by kind."""
        self.px = np.full(1 + seams + 1, _FIRST_PX)
        """The noise floors, by kind."""

    def update(self, residual: Floats, *, displaceable: bool) -> None:
        """Estimate the noise floors from residuals (k, 2), mm.

        `displaceable` says whether the displacements of the cameras are unknowns.
        """
        links, (low, high) = self._problem.links, _LIMITS_PX
        for kind, at in enumerate(self._samples):
            seam = 0 < kind <= self._seams
            if len(at) < (_SEAM_LINKS if seam else _MIN_LINKS):
                continue
            scatter = noise_floor(residual, links.noise_mm2, links.px_per_mm, at, low, high)
            if seam and displaceable and scatter > _AT_LIMIT * high:
                scatter = noise_floor(residual, links.noise_mm2, links.px_per_mm, at, high, _DISPLACED_PX)
            if seam and self._problem.surface is not None:
                scatter = max(min(scatter, _SEAM_PX), scatter / _NARROWING)
            if kind == 0 and len(self._all_rows) >= _MIN_LINKS:
                every = noise_floor(residual, links.noise_mm2, links.px_per_mm, self._all_rows, low, high)
                scatter = min(scatter, every)
            self.px[kind] = scatter if len(at) >= _MIN_LINKS else max(scatter, _FIRST_PX)


def _bare(problem: Problem, of_kind: NDArray[np.bool_], raised: NDArray[np.bool_]) -> Ints:
    """Return indices of the links of a kind on the bare board; near components only if the others are too few."""
    bare = (problem.component < 0) & of_kind
    surely = np.flatnonzero(bare & ~raised)
    return surely if len(surely) >= _MIN_LINKS else np.flatnonzero(bare)


def _sample(at: Ints) -> Ints:
    """Return about `_SAMPLE` of the indices."""
    # A contiguous copy: for a slice with a step, Numba would compile another variant while a board waits.
    return np.ascontiguousarray(at[:: max(len(at) // _SAMPLE, 1)])


@compiled
def noise_floor(residual: Floats, noise: Floats, per_unit: Floats, use: Ints, low: float, high: float) -> float:
    """Return the noise floor: the standard deviation per axis that must be added to the stated noise.

    With the noise floor, the median of the squared normalised residuals is that of χ² with two degrees of freedom. As a
    median is used, up to half of the measurements may be outliers.

    Args:
        residual: (k, 2) residuals.
        noise: (k, 2, 2) covariances of the stated noise.
        per_unit: (k,) units of the noise floor per unit of the residuals, for example px per mm.
        use: indices of the measurements that are used.
        low: lower limit of the noise floor.
        high: upper limit of the noise floor.
    """
    left = use.copy()
    surely, undecided = 0, len(use)
    for _ in range(_HALVINGS):
        # bisection in the logarithm: the limits are three orders of magnitude apart
        middle, above = math.sqrt(low * high), 0
        # Measurements above the median of χ² are moved to the front. The next bisection then tests only one of the two
        # parts, so that all bisections together take about as long as two passes over the measurements.
        for at in range(undecided):
            n = left[at]
            x, y, more = residual[n, 0], residual[n, 1], (middle / per_unit[n]) ** 2
            a, b, d = noise[n, 0, 0] + more, noise[n, 0, 1], noise[n, 1, 1] + more
            if d * x * x - 2 * b * x * y + a * y * y > _MEDIAN * (a * d - b * b):
                left[at], left[above] = left[above], n
                above += 1
        if 2 * (surely + above) > len(use):
            low, undecided = middle, above
        else:
            high, surely = middle, surely + above
            undecided -= above
            for at in range(undecided):
                left[at] = left[above + at]
    return math.sqrt(low * high)


_MAX_STEPS = 15
CONVERGED_MM = 5e-5
"""The adjustment ends after a step that moves no row by more than this. Each step is about a tenth of the step before,
so that an error of about a tenth of this limit remains."""
_SAMPLE_PER_ROW, _SAMPLE_CONVERGED_MM = 100, 3e-3
"""For a solution from a subsample of the links: number of links per row, and the value used as `CONVERGED_MM`."""
_KNEE, _CUT = 2.0, 6.0
"""Residuals beyond `_KNEE` standard deviations lose weight (Huber); beyond `_CUT` they have no weight."""
_PAIR_SIGMA_PX, _PAIR_SHARE, _NOISE_SHARE = (0.001, 0.011), 0.25, 0.5
"""Error that all links of one pair of frames have in common, and that does not average out.
Between rows of one camera it is the first constant (interpolation), or the share `_PAIR_SHARE` of that part of the
noise floor that exceeds the image noise, whichever is larger: links that scatter by more than their noise, on rough
surfaces or between rows of unlike exposure, do not err independently. Between two cameras it is the second constant,
because of different light and of the different perspective of points slightly above the board, and at least the share
`_PAIR_SHARE` of the noise floor and the share `_NOISE_SHARE` of the median image noise of the links: noise draws
matches towards certain fractions of a pixel, which are the same in all rows of two cameras. What links have in common
because their patches overlap is not in it: `patch_overlap` computes that."""
_LIGHTS_SIGMA_PX = 0.3
"""The same error between rows of different lights: the bright edges of metal move with the lamp."""
_FLOOR_STEPS = 6
"""The noise floors are estimated in the first steps only, up to this number. Then they stay constant, so that steps
converge."""
_HEIGHT_SIGMA_MM, _SUNK_MM = 3.0, 0.1
"""Prior standard deviation of a component's height, and of a height below the board: components do not lie there."""
_PLAINLY = 3.0
"""Number of standard deviations above the bare board from which on a point lies on a part that the board type does not
list (seeds 102826, 103588: a board with other parts)."""
_FREE_STEPS = 3
"""Number of first steps in which heights may be below the board, and links near components count as links on the board.
The initial motion may be that of the tops of components. Relative to these, the board seems to lie too low."""
_HEIGHT_MIN_LINKS = 3
"""Least number of used links by which the height of a component is reported."""


def adjust(
    problem: Problem, start: Motion, similarity: Floats | None = None, *, converged_mm: float = CONVERGED_MM
) -> AdjustmentResult:
    """Solve for all unknowns.

    Args:
        start: motion to start from; right to a few px.
        similarity: C to start from; needed if the problem has fiducials.
        converged_mm: the adjustment ends after a step that moves no row by more; about a tenth of it remains.
    """
    solver = _Solver(problem, start, similarity)
    solver.run(converged_mm)
    return solver.result()


def solve_subsampled(problem: Problem, start: Motion) -> Motion | None:
    """Estimate the motion, to a thousandth of a millimetre, from a subsample of the links.

    Return None if there are too few links for a subsample.
    """
    every = len(problem.links) // (_SAMPLE_PER_ROW * len(start.angle))
    if every < 2:
        return None
    # Every n-th link of each pair of frames is taken, not every n-th of all links, so that each pair keeps some links.
    some = np.flatnonzero(index_in_group(problem.links.group) % every == 0)
    solver = _Solver(problem.select(some), start, None)
    solver.run(_SAMPLE_CONVERGED_MM)
    return solver.motion


def evaluate_at(problem: Problem, motion: Motion) -> AdjustmentResult:
    """Return residuals and weights of all links at a given motion, as if it were the solution.

    The covariance is not computed: it is 0 in the solution.
    """
    return _Solver(problem, motion, None).result()


class _Solver:
    """The state of one adjustment: its current unknowns, and the arrays that its steps reuse."""

    def __init__(self, problem: Problem, start: Motion, similarity: Floats | None) -> None:
        self.problem = problem
        self.motion = start
        self.similarity = similarity
        links, surface = problem.links, problem.surface
        self.rows = len(start.angle)
        basis = surface.at_links if surface else np.zeros((len(links), 0))
        self.n_surface = basis.shape[1]
        self.surface_mm = np.zeros(self.n_surface)
        between = (links.p == links.q).astype(np.int_)
        self.kind = between * (1 + links.pairs.a[links.group])
        """(k,) kind of each link: 0 between rows, 1 + i between cameras i and i + 1 in one row, and the last one
        between rows of different lights."""
        self.seams = max(int(self.kind.max(initial=0)), 1)
        """Number of kinds of links between cameras."""
        self.kind[mixed := problem.of_two_lights] = 1 + self.seams
        # A component has two heights, one for each kind of link. Two cameras see its top, while links from row to row
        # may lie on its leads or on the board between them. With a single unknown, the difference would lift the whole
        # board.
        self.n_parts = int(problem.component.max(initial=-1)) + 1
        component = np.where(mixed | (problem.component < 0), -1, problem.component + self.n_parts * between)
        self.heights_mm = np.zeros(2 * self.n_parts)
        shared = (4 if problem.fiducials else 0) + self.n_surface
        self.shared = np.arange(3 * self.rows, 3 * self.rows + shared)
        """Columns of the unknowns of C and of the surface, which stand after the rows."""
        self.cameras = MovingCameras(problem, 3 * self.rows + shared)
        surface_column = 3 * self.rows + shared - self.n_surface
        columns = OtherColumns(self.n_surface, surface_column, self.cameras.first_column, 2 * self.n_parts)
        self.coupling = Coupling.of(component, links.arrays, links.pairs, columns)
        self.heights = HeightModel(basis, component)
        self.envelope = self.coupling.envelope(links.arrays, self.rows, shared + self.cameras.unknowns)
        self.factor: NormalEquations | None = None
        self.state = LinkState.zeros(len(links))
        self.linked_steps = linked_steps(links, self.rows)
        self.raised = (problem.component < 0) & problem.reaches_component
        """(k,) whether each link may lie above the board although no component is under it."""
        self.scatter = HeightScatter(problem, component, self.n_parts)
        self.floors = NoiseFloors(problem, self.kind, self.seams, self.raised)
        self.steps = 0

    def run(self, converged_mm: float) -> None:
        """Make steps until one moves no row by `converged_mm` or more, at most `_MAX_STEPS`."""
        for _ in range(_MAX_STEPS):
            # As long as their prior is wide, cameras may seem displaced: the first steps do not count.
            still = self.step() < converged_mm and self.steps > _FREE_STEPS
            if still and self.cameras.settled and not self.cameras.reconsider():
                break

    def step(self) -> float:
        """Make one reweighted Gauss-Newton step; return the largest change of a shift in mm."""
        self.steps += 1
        priors = self._priors()
        self._compute_residuals()
        # in this order: the noise floor depends on the residuals, and the weights depend on the noise floor
        if self.steps <= _FLOOR_STEPS:
            self.floors.update(self.state.residual, displaceable=bool(self.cameras.unknowns))
        self._compute_weights()
        normal, heights = self._assembly(priors).whole()
        eliminate_heights(self.coupling, heights, normal)
        hold_first_row(normal)
        self.cameras.regularise(self.envelope, normal)
        factorise(normal)
        forward = self.cameras.constrain(self.envelope, normal)
        self.factor = normal
        return self._move(solve_backward(normal, forward), heights)

    def _priors(self) -> list[Equations]:
        """Return all equations but those of links: of the belt, of detections and scale, of the surface."""
        return [self._belt(), *self._fiducials(), self._surface()]

    def _assembly(self, priors: list[Equations]) -> Assembly:
        """Return the parts of the normal equations at the current unknowns, residuals and weights."""
        sunk_mm = _HEIGHT_SIGMA_MM if self.steps <= _FREE_STEPS else _SUNK_MM
        heights = self.coupling.equations(self.heights_mm, _HEIGHT_SIGMA_MM, sunk_mm)
        model = LinkModel(self.heights, self.coupling, self.problem.links.pairs, self.cameras.effects)
        return Assembly(self.envelope, priors, self.cameras.links, self._motion_arrays(), model, self.state, heights)

    def _move(self, delta: Floats, heights: HeightEquations) -> float:
        """Add the solution (n,) of a step to all unknowns; return the largest change of a shift in mm.

        The changes of the eliminated heights are computed from `heights`.
        """
        rows = delta[: 3 * self.rows].reshape(self.rows, 3)
        self.motion = replace(self.motion, angle=self.motion.angle + rows[:, 0], shift=self.motion.shift + rows[:, 1:])
        if self.similarity is not None:
            self.similarity = self.similarity + delta[self.shared[:4]]
        self.surface_mm = self.surface_mm + delta[self.shared[len(self.shared) - self.n_surface :]]
        self.heights_mm = self.heights_mm + height_changes(self.coupling, heights, delta)
        self.cameras.move(delta)
        return float(np.abs(rows[:, 1:]).max())

    def _motion_arrays(self) -> MotionArrays:
        """Return the current motion in the form that compiled functions take."""
        return MotionArrays(self.motion.angle, self.motion.shift, self.motion.pivot)

    def _compute_residuals(self) -> None:
        """Compute the residual of every link at the current unknowns."""
        height = self.heights.basis @ self.surface_mm + np.append(self.heights_mm, 0.0)[self.heights.component]
        compute_residuals(self.cameras.links, self._motion_arrays(), height, self.state)

    def _compute_weights(self) -> None:
        """Compute the robust weights of the links from their current residuals and the noise floor."""
        links = self.problem.links
        floor_px, noise_px = self.floors.px, self.floors.noise_px
        shared_px = np.maximum(_PAIR_SIGMA_PX[1], np.maximum(_NOISE_SHARE * noise_px, _PAIR_SHARE * floor_px))
        beyond_px = np.sqrt(max(floor_px[0] ** 2 - noise_px[0] ** 2, 0.0))
        shared_px[0], shared_px[-1] = max(_PAIR_SIGMA_PX[0], _PAIR_SHARE * beyond_px), _LIGHTS_SIGMA_PX
        free = self.steps <= _FREE_STEPS
        raised = np.zeros_like(self.raised) if free else self.raised
        plainly = np.inf if free or not self.n_surface or not self.n_parts else _PLAINLY
        scatter_mm, common_mm = self.scatter.at(self.heights_mm.reshape(2, -1))
        loss = _KNEE, _CUT
        noise = NoiseModel(
            self.kind, floor_px, shared_px, *loss, raised, scatter_mm, self.scatter.cell, common_mm, plainly
        )
        compute_weights(links.arrays, noise, len(links.groups), self.state)

    def _belt(self) -> Equations:
        """Return the prior of the motion between consecutive rows: the belt moves at its measured mean velocity.

        This prior determines the position of rows without links.
        """
        problem, velocity = self.problem, self.problem.velocity_mm_s
        if self.rows > 1:
            dt = np.diff(problem.times_s)
            steps = -np.diff(self.motion.shift, axis=0)[self.linked_steps] / dt[self.linked_steps, None]
            # Weighted mean of the measured steps and of the nominal speed, each with its own variance.
            prior = STEP_TOLERANCE**2 / SPEED_TOLERANCE**2
            velocity = (steps.sum(0) + prior * velocity) / (len(steps) + prior)
        columns, slopes, rest = belt_equations(self.motion, problem.times_s, velocity)
        if self.rows > 1:
            let_irregular_steps_free(rest, slopes, dt * float(np.hypot(*velocity)), self.linked_steps)
        return columns, slopes, rest

    def _surface(self) -> Equations:
        """Return the prior of the surface: every coefficient is 0 with its prior standard deviation at its value."""
        sigma = prior_sigma_mm(self.surface_mm, self.problem.surface.sigma_mm) if self.problem.surface else np.ones(0)
        columns = self.shared[None, len(self.shared) - self.n_surface :]
        return columns, np.diag(1 / sigma)[None], (self.surface_mm / sigma)[None]

    def _fiducials(self) -> list[Equations]:
        """Return the equations of the detections and of the scale of C; none if the problem has no fiducials."""
        points, c = self.cameras.points, self.similarity
        if points is None or c is None:
            return []
        residual, jacobian = self._fiducial_residuals(c)
        others = np.broadcast_to(self.shared, (len(points.row), len(self.shared)))
        if self.cameras.unknowns:
            turn = row_changes(self.cameras.effects, points.camera, self.motion.angle[points.row], self.motion.pivot)
            jacobian = np.concatenate([jacobian, jacobian[:, :, :3] @ turn], 2)
            others = np.concatenate([others, self.cameras.columns_of(points.camera)], 1)
        detections = detection_equations(points, residual, jacobian, others)
        return [detections, scale_equation(c, self.problem.nominal_scale, self.shared[:2])]

    def _fiducial_residuals(self, c: Floats) -> tuple[Floats, Floats]:
        """Return the residuals and the Jacobian of the detections at similarity c and the other current unknowns."""
        points, surface = self.cameras.points, self.problem.surface
        assert points is not None
        basis = surface.at_fiducials if surface else np.zeros((len(points.row), 0))
        return fiducial_residuals(points, self.motion, c, basis, self.surface_mm)

    def result(self) -> AdjustmentResult:
        """Return the current unknowns, their covariance, and the residuals and weights of all links at them."""
        self._compute_residuals()
        self._compute_weights()
        links, state, points = self.problem.links, self.state, self.problem.fiducials
        sigma0 = 1.0
        if len(links):
            # This lower bound avoids a division by zero where no link has any weight.
            sigma0 = float(np.sqrt(np.average(state.sigma**2, weights=np.maximum(state.robust, 1e-9))))
        fiducial_px = np.zeros((0, 2))
        if points is not None and self.similarity is not None:
            fiducial_px = self._fiducial_residuals(self.similarity)[0] * points.px_per_mm[:, None]
        u = 3 + len(self.shared)
        covariance = self.cameras.widen(self._covariance(), u)
        return AdjustmentResult(
            self.motion,
            self.similarity,
            self.surface_mm,
            self._reported_heights(),
            np.ascontiguousarray(covariance[:, :u, :u]),
            state.sigma,
            state.residual * links.px_per_mm[:, None],
            state.robust,
            fiducial_px,
            float(self.floors.px[0]),
            sigma0,
            self.cameras.displaced_problem(),
            self.cameras.estimate(covariance, u),
            self._influence(),
        )

    def _influence(self) -> Influence | None:
        """Examine the influence of single places and marks on the solution; None before C is an unknown."""
        points = self.cameras.points
        if self.similarity is None or points is None or not self.steps:
            return None
        first = 3 * self.rows + len(self.shared)
        held = np.arange(first, first + self.cameras.unknowns)
        assembly = self._assembly(self._priors())
        return examine_influence(assembly, self.problem.links.seam, points, len(self.shared), held)

    def _covariance(self) -> Floats:
        """Return for each row the covariance (v, v) of its unknowns, C, the surface and the cameras.

        It is 0 before the first step.
        """
        size = 3 + len(self.shared) + self.cameras.unknowns
        covariance = np.zeros((self.rows, size, size))
        if self.factor is not None:
            covariance = row_blocks(self.envelope, inverse(self.factor, self.rows))
            # The gauge fixes row 0: the lines of row 0 in the inverse are those of the identity, not a covariance.
            covariance[0, :3] = covariance[0, :, :3] = 0
        return covariance

    def _reported_heights(self) -> Floats:
        """Return the heights of all components for both kinds of links (2, parts); NaN where too few links are used."""
        component = self.heights.component
        on = component >= 0
        used = np.bincount(component[on], self.state.robust[on] > USED, minlength=2 * self.n_parts)
        return np.where(used >= _HEIGHT_MIN_LINKS, self.heights_mm, np.nan).reshape(2, self.n_parts)
