"""Adjust a run: estimate the motion of all rows and C together, from all links and detections.

The unknowns are (φ_j, s_j) of every row j, the four numbers of the similarity C once fiducials are assigned, the
coefficients of the surface if one is requested, the heights of the components on which links lie, and the displacements
of the cameras against their calibration. The paper chains the rows (equations 11–16), so that their errors add up. Here
all links are used together, in a robust least-squares solution by iteratively reweighted Gauss-Newton.
"""

from __future__ import annotations

import cmath
import math
from dataclasses import replace
from typing import NamedTuple

import numpy as np
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.geometry.transforms import Floats
from vaoi_station.steps import Steps, completed
from vaoi_station.stitching.adjustment.cameras import MovingCameras
from vaoi_station.stitching.adjustment.envelope import (
    NormalEquations,
    factorise,
    hold_first_row,
    inverse,
    solve_backward,
)
from vaoi_station.stitching.adjustment.equations import (
    Coupling,
    Equations,
    HeightEquations,
    HeightScatter,
    LinkModel,
    LinkState,
    NoiseModel,
    PointHeights,
    compute_residuals,
    compute_weights,
    detection_equations,
    detection_sigma_mm,
    eliminate_heights,
    fiducial_residuals,
    scale_equation,
    stable_order,
)
from vaoi_station.stitching.adjustment.influence import Assembly, examine_influence
from vaoi_station.stitching.adjustment.motion import Motion, belt_equations, measure_step
from vaoi_station.stitching.adjustment.problem import USED, AdjustmentResult, Influence, Ints, Problem, prior_sigma_mm

_MEDIAN = 2 * math.log(2)  # median of the χ² distribution with two degrees of freedom
_HALVINGS = 12  # number of bisections. With limits of 0.003 and 5 px, the result is uncertain by 0.2 %

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
    """The noise floors of the links of a problem, by kind: how much they scatter beyond their stated noise.

    Kinds are 0 between rows, 1 + i between cameras i and i + 1 in one row, and the last one between rows of different
    lights. Each pair of neighbouring cameras is a kind of its own: a lifted board or a displaced camera at first causes
    a large scatter, but only in the links between the cameras concerned. All other links keep their weight until the
    surface and the displacements explain this scatter.
    """

    def __init__(self, problem: Problem, raised: NDArray[np.bool_]) -> None:
        """Choose the links from which the noise floors are estimated.

        `raised` (k,) says whether each link may lie above the board although no component is under it.
        """
        self._problem, links = problem, problem.links
        self.kind = np.where(links.p == links.q, 1 + links.camera_a, 0)
        self._seams = max(int(self.kind.max(initial=0)), 1)
        self.kind[problem.of_two_lights] = 1 + self._seams
        on_board = np.flatnonzero(problem.component < 0)
        kinds = self.kind[on_board]
        ends = np.cumsum(np.bincount(kinds, minlength=self._seams + 2))[:-1]
        bare = np.split(on_board[stable_order(kinds)], ends)
        # near components only if the others are too few
        surely = [at[~raised[at]] for at in bare]
        surely = [own if len(own) >= _MIN_LINKS else at for own, at in zip(surely, bare, strict=True)]
        # Indices of sampled links on the bare board, by kind. The model explains these links: what is left is noise.
        self._samples = [_sample(at) for at in surely]
        rows = np.flatnonzero(self.kind == 0)
        self._all_rows = _sample(rows if len(surely[0]) < _FEW else rows[:0])
        self.noise_px = np.array([links.median_noise_px(at) for at in self._samples])
        self.px = np.full(len(bare), _FIRST_PX)

    def update(self, residual: Floats, *, displaceable: bool) -> None:
        """Estimate the noise floors from residuals (k, 2), mm.

        `displaceable` says whether the displacements of the cameras are unknowns.
        """
        links, (low, high) = self._problem.links, _LIMITS_PX

        def scatter_of(at: Ints, low: float = low, high: float = high) -> float:
            return noise_floor(residual, links.noise_mm2, links.px_per_mm, at, low, high)

        for kind, at in enumerate(self._samples):
            seam = 0 < kind <= self._seams
            if len(at) < (_SEAM_LINKS if seam else _MIN_LINKS):
                continue
            scatter = scatter_of(at)
            if seam and displaceable and scatter > _AT_LIMIT * high:
                scatter = scatter_of(at, high, _DISPLACED_PX)
            if seam and self._problem.surface is not None:
                scatter = max(min(scatter, _SEAM_PX), scatter / _NARROWING)
            if kind == 0 and len(self._all_rows) >= _MIN_LINKS:
                scatter = min(scatter, scatter_of(self._all_rows))
            self.px[kind] = scatter if len(at) >= _MIN_LINKS else max(scatter, _FIRST_PX)

    def shared_px(self) -> Floats:
        """Return for each kind the σ of the error that all links of one pair of frames have in common."""
        out = np.maximum(_PAIR_SIGMA_PX[1], np.maximum(_NOISE_SHARE * self.noise_px, _PAIR_SHARE * self.px))
        beyond_px = np.sqrt(max(self.px[0] ** 2 - self.noise_px[0] ** 2, 0.0))
        out[0], out[-1] = max(_PAIR_SIGMA_PX[0], _PAIR_SHARE * beyond_px), _LIGHTS_SIGMA_PX
        return np.asarray(out)


def _sample(at: Ints) -> Ints:
    # A contiguous copy: for a slice with a step, Numba would compile another variant while a board waits.
    return np.ascontiguousarray(at[:: max(len(at) // _SAMPLE, 1)])


@compiled
def noise_floor(residual: Floats, noise: Floats, per_unit: Floats, use: Ints, low: float, high: float) -> float:
    """Return the noise floor: the standard deviation per axis that must be added to the stated noise.

    With the noise floor, the median of the squared normalised residuals is that of χ² with two degrees of freedom. As a
    median is used, up to half of the measurements may be outliers. The result lies between `low` and `high`.

    Args:
        residual: (k, 2) residuals.
        noise: (k, 2, 2) covariances of the stated noise.
        per_unit: (k,) units of the noise floor per unit of the residuals, for example px per mm.
        use: indices of the measurements that are used.
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
_SAMPLE_LINKS, _PER_ROW = 8000, 250
"""Least number of links in the sample that the first steps use: in all, and for each row. With less than twice as many
links, all of them are used."""
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
because their patches overlap is not in it: `LinkArrays.overlap` has that."""
_LIGHTS_SIGMA_PX = 0.3  # the same error between rows of different lights: the bright edges of metal move with the lamp
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
_HEIGHT_MIN_LINKS = 3  # least number of used links by which the height of a component is reported


_MOST_STEPS_ON, _USED_SHARE = 4, 0.7
"""Largest number of steps that go on from the unknowns of all rows but the last, and least share of the last row's
links that must then be used, as a share of that of all links. Otherwise the adjustment starts anew."""


class LinkSums(NamedTuple):
    """The sum of the normal equations of links at a solution, with the noise floors of their weights."""

    normal: NormalEquations
    heights: HeightEquations
    coupling: Coupling
    floor_px: Floats
    noise_px: Floats


class Unknowns(NamedTuple):
    """The solution of an adjustment of the first rows of a run, from which that of one row more goes on."""

    problem: Problem
    motion: Motion
    similarity: Floats
    surface_mm: Floats
    heights_mm: Floats  # (2, number of components)
    displacement_px: Floats  # (n, 3) of the cameras
    sums: LinkSums | None  # None if links are so few that a step with all of them takes hardly longer


def adjust(
    problem: Problem,
    start: Motion,
    similarity: Floats | None = None,
    *,
    converged_mm: float = CONVERGED_MM,
    known: Unknowns | None = None,
) -> AdjustmentResult:
    """Solve for all unknowns.

    Args:
        start: motion to start from; right to a few px.
        similarity: C to start from; needed if the problem has fiducials.
        converged_mm: the adjustment ends after a step that moves no row by more; about a tenth of it remains.
        known: the solution for all rows but the last one, if there is one. The result differs by what remains.
    """
    if known is not None:
        solver = _Solver(problem, start, similarity)
        solver.go_on_from(known)
        if completed(solver.run(converged_mm, _MOST_STEPS_ON)) and solver.last_row_fits:
            return solver.result()
    solver = _Solver(problem, start, similarity)
    completed(solver.solve(converged_mm))
    return solver.result()


def adjust_first_rows(problem: Problem, start: Motion, similarity: Floats) -> Steps[Unknowns]:
    """Solve for all unknowns of a run that goes on; for the arguments see `adjust`."""
    solver = _Solver(problem, start, similarity)
    yield from solver.solve(CONVERGED_MM)
    return solver.unknowns


def sample_of(problem: Problem, every: int) -> Problem:
    """Return the problem with every n-th link of each pair of frames, so that each pair keeps some."""
    begins = problem.links.begins
    in_pair = np.arange(begins[-1]) - np.repeat(begins[:-1], np.diff(begins))
    return problem.select(np.flatnonzero(in_pair % every == 0))


def linked_steps(problem: Problem) -> NDArray[np.bool_]:
    """Return for each step from a row to the next (rows − 1,) whether a link connects rows across this step."""
    rows = len(problem.times_s)
    change = np.bincount(problem.links.p, minlength=rows) - np.bincount(problem.links.q, minlength=rows)
    return np.asarray(np.cumsum(change)[:-1] > 0)


class _UsedLinks:
    """The links that the steps of an adjustment use, all or a sample, with what follows from where they lie."""

    def __init__(self, problem: Problem, parts: int) -> None:
        links, surface = problem.links, problem.surface
        self.arrays, self.count = links.arrays, len(links)
        self.basis = surface.at_links if surface else np.zeros((self.count, 0))
        # A component has two heights, one for each kind of link. Two cameras see its top, while links from row to row
        # may lie on its leads or on the board between them. With a single unknown, the difference would lift the whole
        # board.
        bare = problem.of_two_lights | (problem.component < 0)
        self.component = np.where(bare, -1, problem.component + parts * (links.p == links.q))
        self.raised = (problem.component < 0) & problem.reaches_component
        self.scatter = HeightScatter(problem, self.component, parts)
        self.floors = NoiseFloors(problem, self.raised)
        self.state = LinkState.of(self.arrays, movable=bool(problem.cameras))


class _Solver:
    """The state of one adjustment: its current unknowns, and the arrays that its steps reuse."""

    def __init__(self, problem: Problem, start: Motion, similarity: Floats | None) -> None:
        self.problem, self.motion, self.similarity = problem, start, similarity
        self.rows, self.n_parts = len(start.angle), int(problem.component.max(initial=-1)) + 1
        self.every = self.used = _UsedLinks(problem, self.n_parts)
        self.n_surface = self.every.basis.shape[1]
        self.surface_mm, self.heights_mm = np.zeros(self.n_surface), np.zeros(2 * self.n_parts)
        # C and the surface stand after the rows, the cameras last.
        first, shared = 3 * self.rows, (4 if problem.fiducials else 0) + self.n_surface
        self.shared = np.arange(first, first + shared)
        self.cameras = MovingCameras(problem, first + shared)
        columns = first + shared - self.n_surface, self.cameras.first_column
        self.coupling = Coupling.of(
            self.every.component, len(self.heights_mm), self.every.arrays, self.rows, self.n_surface, columns
        )
        self.empty = NormalEquations.of(self.coupling.furthest, shared + self.cameras.unknowns)
        self.linked_steps = linked_steps(problem)
        self.steps = 0
        # those of all links that the next step does not use
        self.sums: LinkSums | None = None
        # of the last step: the factor of its equations, their parts, and their sum before anything was eliminated
        self.factor: NormalEquations | None = None
        self.summed: tuple[Assembly, NormalEquations, HeightEquations] | None = None
        # of the detections: columns of their unknowns, and standard deviations
        self._columns: Ints | None = None
        self._detection_mm = np.zeros(0)

    @property
    def one_of(self) -> int:
        """Of how many links a sample has one; 0 or 1 if they are not many."""
        return len(self.problem.links) // max(_SAMPLE_LINKS, _PER_ROW * self.rows)

    def solve(self, converged_mm: float) -> Steps[None]:
        """Make all steps from the start, the first ones with a sample if links are many."""
        if self.similarity is not None and self.one_of > 1:
            yield from self.approach(self.one_of)
        yield from self.run(converged_mm)

    def approach(self, every: int) -> Steps[None]:
        """Make the free steps and one more with every n-th link of each pair of frames."""
        self.used = _UsedLinks(sample_of(self.problem, every), self.n_parts)
        for _ in range(_FREE_STEPS + 1):
            yield
            self.step()
        self.used, self.steps = self.every, _FREE_STEPS

    def run(self, converged_mm: float, most_steps: int = _MAX_STEPS) -> Steps[bool]:
        """Make steps until one moves no row by `converged_mm` or more; return False if that takes too many."""
        for _ in range(most_steps):
            yield
            # As long as their prior is wide, cameras may seem displaced: the first steps do not count. Nor does a step
            # with a known sum: the noise floors, the weights and the influence of all links follow from later ones.
            every = self.sums is None
            still = self.step() < converged_mm and self.steps > _FREE_STEPS and every
            if still and self.cameras.settled and not self.cameras.reconsider():
                return True
        return False

    def go_on_from(self, known: Unknowns) -> None:
        """Take over the solution of all rows but the last one, and place the last one by its links to them."""
        before, start, row = known.motion, self.motion, self.rows - 1
        turn = before.angle[-1] - start.angle[row - 1]
        step = complex(*(start.shift[row] - start.shift[row - 1])) * cmath.exp(1j * turn)
        self._set_last_row(before, start.angle[row] + turn, complex(*before.shift[-1]) + step)
        self.similarity, self.surface_mm, self.steps = known.similarity, known.surface_mm, _FREE_STEPS
        heights_mm, parts = np.zeros((2, self.n_parts)), min(self.n_parts, known.heights_mm.shape[1])
        heights_mm[:, :parts] = known.heights_mm[:, :parts]
        self.heights_mm = heights_mm.ravel()
        self.cameras.begin_at(known.displacement_px)
        self._use_sums(known)
        self._compute_residuals()
        at = np.flatnonzero((self.used.arrays.q == row) & (self.used.arrays.p < row))
        if len(at):
            links, state = self.used.arrays, self.used.state
            now_mm = self.motion.board(links.q[at], state.b_mm[at])
            scatter = links.noise_mm2[at], links.px_per_mm[at], links.overlap[at]
            step_mm = measure_step(row, row, now_mm - state.residual[at], now_mm, *scatter)
            middle = complex(*(self.motion.shift[row] + self.motion.pivot)) - step_mm.b_mm
            shift = cmath.exp(1j * step_mm.turn) * middle + step_mm.a_mm - complex(*self.motion.pivot)
            self._set_last_row(before, self.motion.angle[row] + step_mm.turn, shift)

    def _use_sums(self, known: Unknowns) -> None:
        """Let the first step use the links of the last row only, and of all others the sum that is known."""
        count = len(known.problem.links)
        if known.sums is None or not self.problem.begins_with(known.problem):
            return
        later = _UsedLinks(self.problem.select(np.arange(count, self.every.count)), self.n_parts)
        if len(later.floors.px) == len(known.sums.floor_px) and len(later.arrays.p):
            later.floors.px, later.floors.noise_px = known.sums.floor_px, known.sums.noise_px
            self.used, self.sums = later, known.sums

    def _set_last_row(self, before: Motion, angle: float, shift: complex) -> None:
        shifts = np.vstack([before.shift, (shift.real, shift.imag)])
        self.motion = replace(self.motion, angle=np.append(before.angle, angle), shift=shifts)

    @property
    def last_row_fits(self) -> bool:
        """Whether nearly as many links of the last row as of all rows are used."""
        used, links = self.used.state.robust > USED, self.used.arrays
        of_last = used[links.q == self.rows - 1]
        return len(of_last) > 0 and float(of_last.mean()) >= _USED_SHARE * float(used.mean())

    @property
    def unknowns(self) -> Unknowns:
        """The current unknowns."""
        assert self.similarity is not None
        sums = None
        if self.one_of > 1:
            self._compute_residuals()
            self._compute_weights()
            floors, of_links = self.used.floors, self._assembly().of_links()
            sums = LinkSums(*of_links, self.coupling, floors.px, floors.noise_px)
        heights_mm, displacement_px = self.heights_mm.reshape(2, self.n_parts), self.cameras.displacement_px
        solution = self.motion, self.similarity, self.surface_mm, heights_mm, displacement_px
        return Unknowns(self.problem, *solution, sums)

    def step(self) -> float:
        """Make one reweighted Gauss-Newton step; return the largest change of a shift in mm."""
        self.steps += 1
        self._compute_residuals()
        # in this order: the noise floor depends on the residuals, and the weights depend on the noise floor
        if self.steps <= _FLOOR_STEPS and self.sums is None:
            self.used.floors.update(self.used.state.residual, displaceable=bool(self.cameras.unknowns))
        self._compute_weights()
        assembly = self._assembly()
        whole, heights = assembly.whole()
        if self.sums is not None:
            whole.add(self.sums.normal)
            parts = len(self.sums.heights.normal) // 2
            numbers = np.concatenate([np.arange(parts), self.n_parts + np.arange(parts)])
            self.coupling.add(heights, self.sums.heights, self.sums.coupling, numbers)
            self.used, self.sums = self.every, None
        self.summed, normal = (assembly, whole, heights), whole.copy()
        eliminate_heights(self.coupling, heights, normal)
        hold_first_row(normal)
        self.cameras.regularise(normal)
        factorise(normal)
        delta = solve_backward(normal, self.cameras.constrain(normal))
        self.factor = normal
        rows = delta[: 3 * self.rows].reshape(self.rows, 3)
        self.motion = replace(self.motion, angle=self.motion.angle + rows[:, 0], shift=self.motion.shift + rows[:, 1:])
        if self.similarity is not None:
            self.similarity = self.similarity + delta[self.shared[:4]]
        self.surface_mm = self.surface_mm + delta[self._surface_columns]
        self.heights_mm = self.heights_mm + self.coupling.changes(heights, delta)
        self.cameras.move(delta)
        return float(np.abs(rows[:, 1:]).max())

    @property
    def _surface_columns(self) -> Ints:
        return self.shared[len(self.shared) - self.n_surface :]

    def _assembly(self) -> Assembly:
        """Return the parts of the normal equations at the current unknowns, residuals and weights."""
        problem, motion = self.problem, self.motion
        belt = belt_equations(motion, problem.times_s, problem.velocity_mm_s, self.linked_steps)
        # The prior of the surface: every coefficient is 0 with its prior standard deviation at its value.
        sigma = prior_sigma_mm(self.surface_mm, problem.surface.sigma_mm) if problem.surface else np.ones(0)
        surface = self._surface_columns[None], np.diag(1 / sigma)[None], (self.surface_mm / sigma)[None]
        sunk_mm = _HEIGHT_SIGMA_MM if self.steps <= _FREE_STEPS else _SUNK_MM
        heights = self.coupling.equations(self.heights_mm, _HEIGHT_SIGMA_MM, sunk_mm)
        row_changes = self.cameras.effects.row_changes(motion.angle, motion.pivot)
        used, model = self.used, LinkModel(self.used.basis, self.used.component, self.coupling, row_changes)
        priors = [belt, *self._fiducials(row_changes), surface]
        return Assembly(priors, used.arrays, motion.arrays, model, used.state, self.empty, heights)

    def _compute_residuals(self) -> None:
        used, heights = self.used, np.append(self.heights_mm, 0.0)
        points = PointHeights(used.basis, self.surface_mm, used.component, heights)
        compute_residuals(used.arrays, self.motion.arrays, self.cameras.changes, points, used.state)

    def _compute_weights(self) -> None:
        used, free, floors = self.used, self.steps <= _FREE_STEPS, self.used.floors
        raised = np.zeros_like(used.raised) if free else used.raised
        plainly = np.inf if free or not self.n_surface or not self.n_parts else _PLAINLY
        scatter_mm, common_mm = used.scatter.at(self.heights_mm.reshape(2, -1))
        limits = floors.kind, floors.px, floors.shared_px(), _KNEE, _CUT
        noise = NoiseModel(*limits, raised, scatter_mm, used.scatter.cell, common_mm, plainly)
        compute_weights(used.arrays, noise, used.state)

    def _fiducials(self, row_changes: Floats) -> list[Equations]:
        """Return the equations of the detections and of the scale of C; none if the problem has no fiducials."""
        points, c = self.cameras.points, self.similarity
        if points is None or c is None:
            return []
        residual, jacobian = self._fiducial_residuals(c)
        if self.cameras.unknowns:
            turn = row_changes[points.camera, points.row]
            jacobian = np.concatenate([jacobian, jacobian[:, :, :3] @ turn], 2)
        if self._columns is None:
            others = np.broadcast_to(self.shared, (len(points.row), len(self.shared)))
            columns = [3 * points.row[:, None] + np.arange(3), others]
            if self.cameras.unknowns:
                columns.append(self.cameras.first_column + 3 * points.camera[:, None] + np.arange(3))
            self._columns, self._detection_mm = np.concatenate(columns, 1), detection_sigma_mm(points)
        detections = detection_equations(points, self._detection_mm, residual, jacobian, self._columns)
        return [detections, scale_equation(c, self.problem.nominal_scale, self.shared[:2])]

    def _fiducial_residuals(self, c: Floats) -> tuple[Floats, Floats]:
        points, surface = self.cameras.points, self.problem.surface
        assert points is not None
        basis = surface.at_fiducials if surface else np.zeros((len(points.row), 0))
        return fiducial_residuals(points, self.motion, c, basis, self.surface_mm)

    def result(self) -> AdjustmentResult:
        """Return the current unknowns, their covariance, and the residuals and weights of all links at them."""
        influence = self._influence()
        self._compute_residuals()
        self._compute_weights()
        links, state, points = self.problem.links, self.used.state, self.problem.fiducials
        sigma0 = 1.0
        if len(links):
            # This lower bound avoids a division by zero where no link has any weight.
            sigma0 = float(np.sqrt(np.average(state.sigma**2, weights=np.maximum(state.robust, 1e-9))))
        fiducial_px = np.zeros((0, 2))
        if points is not None and self.similarity is not None:
            fiducial_px = self._fiducial_residuals(self.similarity)[0] * points.px_per_mm[:, None]
        u = 3 + len(self.shared)
        covariance = np.zeros((self.rows, u + self.cameras.unknowns, u + self.cameras.unknowns))
        if self.factor is not None:
            covariance = self.factor.row_blocks(inverse(self.factor))
            # The gauge fixes row 0: the lines of row 0 in the inverse are those of the identity, not a covariance.
            covariance[0, :3] = covariance[0, :, :3] = 0
        covariance = self.cameras.widen(covariance, u)
        on = np.flatnonzero((self.used.component >= 0) & (state.robust > USED))
        used = np.bincount(self.used.component[on], minlength=len(self.heights_mm))
        heights_mm = np.where(used >= _HEIGHT_MIN_LINKS, self.heights_mm, np.nan).reshape(2, self.n_parts)
        return AdjustmentResult(
            self.motion,
            self.similarity,
            self.surface_mm,
            heights_mm,
            np.ascontiguousarray(covariance[:, :u, :u]),
            state.sigma,
            state.residual * links.px_per_mm[:, None],
            state.robust,
            fiducial_px,
            float(self.used.floors.px[0]),
            sigma0,
            self.cameras.displaced_problem(state),
            self.cameras.estimate(covariance, u),
            influence,
        )

    def _influence(self) -> Influence | None:
        """Examine the influence of single places and marks on the last step; None before C is an unknown."""
        if self.similarity is None or self.cameras.points is None or self.summed is None:
            return None
        return examine_influence(*self.summed, self.cameras.points, len(self.shared))
