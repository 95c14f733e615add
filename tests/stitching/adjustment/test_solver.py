"""The adjustment on simulated links with a known truth: two cameras, six rows, a board with parts, lifted and bent."""

from __future__ import annotations

import sys
from dataclasses import dataclass, replace
from itertools import pairwise
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from vaoi_station.geometry import Camera
from vaoi_station.geometry.similarity import apply_similarity
from vaoi_station.model import BoardType
from vaoi_station.steps import completed
from vaoi_station.stitching.adjustment import solver as adjustment
from vaoi_station.stitching.adjustment.motion import Motion, nominal_motion
from vaoi_station.stitching.adjustment.problem import (
    SIGMA_MM,
    AdjustmentResult,
    FiducialPoints,
    Problem,
    SurfaceBasis,
    basis,
    to_observations,
)
from vaoi_station.stitching.adjustment.row_motion import motion_from_links
from vaoi_station.stitching.adjustment.solver import NoiseFloors, adjust, adjust_first_rows, noise_floor, sample_of
from vaoi_station.stitching.matching.evidence import Links, Task
from vaoi_station.stitching.matching.refinement import WINDOW_PX


@given(st.integers(0, 10_000), st.integers(1, 40), st.sampled_from([1e-4, 0.02, 3.0]))
def test_half_of_the_used_measurements_are_within_the_median(seed: int, count: int, real: float) -> None:
    """Compare with the same bisections over all measurements."""
    g = np.random.default_rng(seed)
    half = g.normal(0, 0.01, (count, 2, 2))
    residual, noise, px_per_mm = g.normal(0, real, (count, 2)), half @ half.swapaxes(1, 2), g.uniform(5, 50, count)
    use = np.flatnonzero(g.random(count) < 0.7)
    low, high = 0.003, 5.0
    for _ in range(12):
        middle = np.sqrt(low * high)
        wider = noise + ((middle / px_per_mm) ** 2)[:, None, None] * np.eye(2)
        chi2 = np.einsum("ki,kij,kj->k", residual, np.linalg.inv(wider), residual)[use]
        low, high = (middle, high) if 2 * (chi2 > 2 * np.log(2)).sum() > len(use) else (low, middle)
    assert noise_floor(residual, noise, px_per_mm, use, 0.003, 5.0) == pytest.approx(np.sqrt(low * high), rel=1e-9)


def test_few_false_links_on_the_bare_board_do_not_set_the_noise_of_all(workshop: Any) -> None:
    """At the edges of a board on a bed with texture, most of the links that seem to be on the bare board are false."""
    g, count, bare = np.random.default_rng(2), 300, 30
    px = g.uniform(50, 350, (count, 2))
    links = to_observations(
        [Links(Task("rows", (0, 0), (0, 1)), px, px, np.tile(np.eye(2) / 0.01**2, (count, 1, 1)), np.ones(count))],
        (workshop.camera(),),
    )
    component = np.where(np.arange(count) < bare, -1, 0)
    problem = Problem(np.array([0.0, 0.1]), np.array([0.0, 50.0]), links, component)
    residual = g.normal(0, 0.01 / 10, (count, 2))
    residual[:20] = g.normal(0, 2.0 / 10, (20, 2))
    floors = NoiseFloors(problem, np.zeros(count, np.bool_))
    floors.update(residual, displaceable=False)
    assert floors.px[0] < 0.05


Array = NDArray[np.float64]
ROWS, STEP_MM, PX_PER_MM = 6, 8.0, 10.0
TIMES: Array = np.arange(ROWS, dtype=np.float64) * 0.1
VELOCITY = np.array([0.0, STEP_MM / 0.1])
BOARD = BoardType(name="b", outline=((-16.0, -46.0), (16.0, 8.0)))
C = np.array([0.9998, 0.012, 0.4, -0.7])
FIDUCIALS = np.array([[-13.0, -40.0], [12.0, 4.0], [13.0, -38.0]])
STATED_PX, REAL_PX, PAIR_PX = 0.01, 0.03, 0.006
MARK_PX = 0.005
"""Standard deviation of each detection, and of the error that all detections of one fiducial share."""


@dataclass
class Bench:
    """A known truth, and its observations."""

    g: np.random.Generator
    cameras: tuple[Camera, ...]
    motion: Motion
    surface: Array
    heights: Array
    real_px: float = REAL_PX
    pair_px: float = PAIR_PX

    def height(self, board: Array, component: NDArray[np.int_]) -> Array:
        """Height of board points: the surface, and the part on it."""
        cad = (board - C[2:]) @ np.array([[C[0], -C[1]], [C[1], C[0]]]) / (C[0] ** 2 + C[1] ** 2)
        return np.asarray(basis(BOARD, cad) @ self.surface + np.append(self.heights, 0.0)[component])

    def seen(self, camera: int, row: int, board: Array, height: Array) -> Array:
        return self.cameras[camera].project(self.motion.row_from_tester(row)(board), height)

    def links(self, a: tuple[int, int], b: tuple[int, int], count: int = 40) -> tuple[Links, NDArray[np.int_]]:
        """Noisy links between two frames, and the component each lies on."""
        board = self.g.uniform((-22, -62), (22, 22), (4000, 2))
        component = np.where(self.g.random(4000) < 0.3, self.g.integers(0, max(len(self.heights), 1), 4000), -1)
        component = component if len(self.heights) else np.full(4000, -1)
        height = self.height(board, component)
        pa, pb = self.seen(*a, board, height), self.seen(*b, board, height)
        both = np.flatnonzero(self.cameras[a[0]].sees(pa, 5) & self.cameras[b[0]].sees(pb, 5))[:count]
        shared = self.g.normal(0, self.pair_px, 2)
        noise = self.real_px * self.patch_noise(pa[both]) + shared
        task = Task("rows" if a[0] == b[0] else "neighbours", a, b, 0.1 * (b[1] - a[1]))
        information = np.tile(np.eye(2) / STATED_PX**2, (len(both), 1, 1))
        return Links(task, pa[both], pb[both] + noise, information, np.ones(len(both))), component[both]

    def patch_noise(self, px: Array) -> Array:
        """Noise of patches at these pixels: those that overlap have the noise of the pixels in both in common."""
        apart = np.abs(px[:, None] - px[None])
        common = np.maximum(1 - apart / WINDOW_PX, 0).prod(-1) + 1e-9 * np.eye(len(px))
        return np.asarray(np.linalg.cholesky(common) @ self.g.normal(0, 1, px.shape))

    def problem(self, *, without: tuple[int, ...] = (), outliers: float = 0.0) -> Problem:
        """The problem of all links of the run except those of some rows."""
        frames = [((i, p), (i, q)) for i in (0, 1) for p, q in pairwise(range(ROWS))]
        frames += [((0, j), (1, j)) for j in range(ROWS)]
        made = [self.links(a, b) for a, b in frames if not {a[1], b[1]} & set(without)]
        for links, _ in made:
            wild = self.g.random(len(links.b_px)) < outliers
            links.b_px[wild] += self.g.uniform(0.5, 4, (int(wild.sum()), 2)) * self.g.choice(
                [-1, 1], (int(wild.sum()), 2)
            )
        component = np.concatenate([c for _, c in made])
        return Problem(TIMES, VELOCITY, to_observations([e for e, _ in made], self.cameras), component)

    def with_fiducials(self, problem: Problem, *, surface: bool = False) -> Problem:
        """The problem with all detections of the fiducials."""
        board = apply_similarity(C, FIDUCIALS)
        height = self.height(board, np.full(len(board), -1))
        artwork = self.g.normal(0, MARK_PX, (len(board), 2))
        found: list[tuple[int, Array, Array, Array, int, int]] = []
        for i, camera in enumerate(self.cameras):
            for j in range(ROWS):
                px = self.seen(i, j, board, height)
                for n in np.flatnonzero(camera.sees(px, 8)):
                    ground = camera.ground(px[n] + artwork[n] + self.g.normal(0, MARK_PX, 2))
                    found.append((j, ground, camera.parallax(ground), FIDUCIALS[n], int(n), i))
        row, ground, lean, cad, which, seen_by = (np.array([f[k] for f in found]) for k in range(6))
        k = len(found)
        sigma, resolution = np.full(k, 0.005 / PX_PER_MM), np.full(k, PX_PER_MM)
        points = FiducialPoints(row, ground, lean, cad, sigma, resolution, which, seen_by)
        if not surface:
            return replace(problem, fiducials=points)
        o = problem.links
        on_board = self.motion.board(o.p, o.a_mm)
        cad_of_links = (on_board - C[2:]) @ np.array([[C[0], -C[1]], [C[1], C[0]]]) / (C[0] ** 2 + C[1] ** 2)
        return replace(
            problem, fiducials=points, surface=SurfaceBasis(basis(BOARD, cad_of_links), basis(BOARD, cad), SIGMA_MM)
        )

    def errors(self, found: AdjustmentResult) -> Array:
        """Deviation of the unknowns of rows 1 … m−1, in the order of the covariance."""
        angle, shift = found.motion.angle - self.motion.angle, found.motion.shift - self.motion.shift
        return np.column_stack([angle, shift])[1:].ravel()


@pytest.fixture
def bench(workshop: Any) -> Any:
    def make(seed: int = 0, *, surface: tuple[float, ...] = (0.0,) * 6, heights: tuple[float, ...] = ()) -> Bench:
        g = np.random.default_rng(seed)
        left, right = (workshop.camera((x, 0.0), distance_mm=100.0, angle_rad=t) for x, t in ((-7, 0.003), (7, -0.004)))
        pivot = np.array([0.0, 0.0])
        angle, sway = np.cumsum(g.normal(0, 0.001, ROWS)), np.cumsum(g.normal(0, 0.05, ROWS))
        along = np.cumsum(g.normal(STEP_MM, 0.1, ROWS))
        shift = -np.column_stack([sway - sway[0], along - along[0]])
        motion = Motion(angle - angle[0], shift, pivot)
        return Bench(g, (left, right), motion, np.array(surface), np.array(heights))

    return make


def started(problem: Problem) -> Motion:
    # As in a run: the board is not located yet.
    links_alone = replace(problem, fiducials=None, surface=None)
    return motion_from_links(links_alone, nominal_motion(TIMES, VELOCITY, np.zeros(2))).motion


def test_the_joined_steps_between_rows_are_near_the_solution(bench: Any) -> None:
    truth = bench(1)
    frames = [((i, p), (i, q)) for i in (0, 1) for p, q in pairwise(range(ROWS))] * 5
    many = to_observations([truth.links(a, b, count=400)[0] for a, b in frames], truth.cameras)
    problem = replace(truth.problem(), links=many, component=np.full(len(many), -1))
    rough = started(problem)
    exact = adjust(problem, rough).motion
    assert np.abs(rough.shift - exact.shift).max() < 0.002
    assert np.abs(rough.angle - exact.angle).max() < 1e-4


def test_a_fifth_of_outliers_does_not_matter(bench: Any) -> None:
    truth = bench(2)
    problem = truth.problem(outliers=0.2)
    found = adjust(problem, started(problem))
    error = truth.errors(found).reshape(-1, 3)
    assert np.hypot(*error[:, 1:].T).max() * PX_PER_MM < 0.08
    assert (found.weight < 0.05).mean() == pytest.approx(0.2, abs=0.05)


def test_the_stated_covariance_is_that_of_the_errors(bench: Any) -> None:
    normalised = []
    for seed in range(16):
        truth = bench(100 + seed)
        problem = truth.problem()
        found = adjust(problem, started(problem))
        errors = truth.errors(found).reshape(-1, 3)
        of_rows = found.covariance[1:, :3, :3]
        normalised += [e @ np.linalg.solve(c, e) / 3 for e, c in zip(errors, of_rows, strict=True)]
    print("mean normalised squared error:", np.mean(normalised))
    assert 0.5 < np.mean(normalised) < 2.0


def test_c_is_estimated_from_detections_with_its_uncertainty(bench: Any) -> None:
    normalised = []
    for seed in range(12):
        truth = bench(200 + seed)
        problem = truth.with_fiducials(truth.problem())
        found = adjust(problem, started(problem), np.array([1.0, 0.01, 0.2, -0.5]))
        assert found.similarity is not None
        off = apply_similarity(found.similarity, FIDUCIALS) - apply_similarity(C, FIDUCIALS)
        assert np.abs(off).max() * PX_PER_MM < 0.15
        assert np.abs(found.fiducial_px).max() < 0.15
        error = found.similarity - C
        assert (found.covariance[:, 3:7, 3:7] == found.covariance[0, 3:7, 3:7]).all(), "C is that of all rows"
        normalised.append(error @ np.linalg.solve(found.covariance[0, 3:7, 3:7], error) / 4)
    print("mean normalised squared error of C:", np.mean(normalised))
    assert 0.3 < np.mean(normalised) < 2.0


@pytest.mark.parametrize("surface", [(0.5, 0, 0, 0, 0, 0), (0.4, 0.05, -0.08, -0.2, 0.03, -0.3)])
def test_a_lifted_and_bent_board_is_measured(bench: Any, surface: tuple[float, ...]) -> None:
    truth = bench(9, surface=surface)
    problem = truth.with_fiducials(truth.problem(), surface=True)
    found = adjust(problem, started(problem), np.array([1.0, 0.01, 0.2, -0.5]))
    sigma = np.sqrt(np.diag(found.covariance[0])[-6:])
    assert (np.abs(found.surface_mm - surface) < 4 * sigma + 0.01).all()
    assert found.surface_mm[0] == pytest.approx(surface[0], abs=0.06)
    error = truth.errors(found).reshape(-1, 3)
    assert np.hypot(*error[:, 1:].T).max() * PX_PER_MM < 0.25
    blind = adjust(replace(problem, surface=None), started(problem), np.array([1.0, 0.01, 0.2, -0.5]))
    assert np.abs(truth.errors(blind)).max() > np.abs(truth.errors(found)).max()


def test_a_tilt_that_few_links_show_is_not_held_back_by_its_prior(bench: Any) -> None:
    """The tilt is five and eight standard deviations of its prior: three noisy links a pair of frames show it."""
    tilt, found = (0.41, -0.61), []
    for seed in range(20, 28):
        truth = replace(bench(seed, surface=(0.1, *tilt, -0.06, 0, -0.09)), real_px=0.15)
        frames = [((i, p), (i, q)) for i in (0, 1) for p, q in pairwise(range(ROWS))]
        few = [truth.links(a, b, count=3)[0] for a, b in frames + [((0, j), (1, j)) for j in range(ROWS)]]
        observed = to_observations(few, truth.cameras)
        problem = truth.with_fiducials(Problem(TIMES, VELOCITY, observed, np.full(len(observed), -1)), surface=True)
        found.append(adjust(problem, started(problem), np.array([1.0, 0.01, 0.2, -0.5])).surface_mm[1:3])
    assert np.mean(found, axis=0) == pytest.approx(tilt, abs=0.06)


def test_what_moves_with_the_lamp_does_not_move_the_rows(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """Links between rows of two lights are all displaced by 0.4 px; those of one light, and fiducials, are not."""
    truth, slow = bench(12), VELOCITY / 2
    truth.motion = replace(truth.motion, shift=truth.motion.shift / 2)  # rows j and j + 2 overlap
    monkeypatch.setattr(sys.modules[__name__], "FIDUCIALS", np.array([[-10.0, -18.0], [9.0, 4.0], [10.0, -16.0]]))
    light = np.arange(ROWS) % 2
    frames = [((i, p), (i, p + n)) for i in (0, 1) for n in (1, 2) for p in range(ROWS - n)]
    made = [truth.links(a, b)[0] for a, b in frames + [((0, j), (1, j)) for j in range(ROWS)]]
    for links in made:
        assert links.task.b is not None
        links.b_px[:, 0] += 0.4 * (light[links.task.b[1]] - light[links.task.a[1]])
    observed = to_observations(made, truth.cameras)
    plain = truth.with_fiducials(Problem(TIMES, slow, observed, np.full(len(observed), -1)))
    problem = replace(plain, light=light)
    one_apart = [m for m in made if m.task.b and m.task.b[1] - m.task.a[1] == 1]
    assert problem.of_two_lights.sum() == sum(len(m.b_px) for m in one_apart)
    start = np.array([1.0, 0.01, 0.2, -0.5])
    begin = motion_from_links(plain, nominal_motion(TIMES, slow, np.zeros(2))).motion
    lit, blind = (adjust(p, begin, start) for p in (problem, plain))
    off_px, blind_px = (np.hypot(*truth.errors(f).reshape(-1, 3)[:, 1:].T).max() * PX_PER_MM for f in (lit, blind))
    assert off_px < 0.06
    assert blind_px > 3 * off_px
    error, sigma = truth.errors(lit).reshape(-1, 3), np.sqrt([np.diag(c)[:3] for c in lit.covariance[1:]])
    assert (np.abs(error) < 4 * sigma).all()


def test_noise_of_a_pair_of_cameras_does_not_average_out(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """The height of the board follows from the links between cameras: their noise widens its σ, many as they are."""
    run = bench(4)
    problem = run.with_fiducials(run.problem(), surface=True)
    o = problem.links
    noise = o.noise_mm2 * np.where(o.p == o.q, 100.0, 1.0)[:, None, None]
    noisy, sigma = replace(problem, links=replace(o, noise_mm2=noise)), []
    for share in (0.0, 0.5):
        monkeypatch.setattr(adjustment, "_NOISE_SHARE", share)
        sigma.append(float(np.sqrt(adjust(noisy, started(noisy), C).covariance[1, 7, 7])))
    assert sigma[1] > 1.2 * sigma[0]


def test_a_start_from_a_sample_of_the_links_ends_where_all_links_lead(
    bench: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """With a surface, component heights, outliers, and cameras that may have moved."""
    truth = bench(4, surface=(0.3, 0.05, 0.0, 0.1, 0.0, 0.0), heights=(1.5, 0.8, 2.0))
    problem = replace(truth.with_fiducials(truth.problem(outliers=0.05), surface=True), cameras=truth.cameras)
    every = adjust(problem, started(problem), C)
    taken: list[int] = []

    def take(problem: Problem, every: int) -> Problem:
        taken.append(every)
        return sample_of(problem, every)

    monkeypatch.setattr(adjustment, "sample_of", take)
    monkeypatch.setattr(adjustment, "_SAMPLE_LINKS", 150)
    monkeypatch.setattr(adjustment, "_PER_ROW", 25)
    sampled = adjust(problem, started(problem), C)
    assert taken == [len(problem.links) // 150]
    assert np.abs(sampled.motion.shift - every.motion.shift).max() < 2e-5
    assert sampled.similarity == pytest.approx(every.similarity, abs=2e-5)
    assert sampled.cameras is not None
    assert every.cameras is not None
    assert sampled.cameras.displacement_px == pytest.approx(every.cameras.displacement_px, abs=2e-3)


@pytest.mark.parametrize("known", ["right", "right, of many links", "wrong"])
def test_the_solution_of_all_rows_but_the_last_leads_to_that_of_all(
    bench: Any, known: str, monkeypatch: pytest.MonkeyPatch
) -> None:
    """If the last row does not fit a solution that is wrong, it is not used."""
    if known == "right, of many links":
        monkeypatch.setattr(adjustment, "_SAMPLE_LINKS", 150)
        monkeypatch.setattr(adjustment, "_PER_ROW", 25)
    truth, last = bench(5, surface=(0.3, 0.05, 0.0, 0.1, 0.0, 0.0), heights=(1.5, 0.8, 2.0)), ROWS - 1
    made = truth.problem(outliers=0.05)
    # As in a run, all links of a row stand behind those of the rows before.
    component = made.component[np.argsort(made.links.q, kind="stable")]
    evidence = sorted(made.links.groups, key=lambda e: e.rows[1])
    early = to_observations([e for e in evidence if e.rows[1] < last], truth.cameras)
    problem = replace(made, links=to_observations(evidence, truth.cameras), component=component)
    problem = replace(truth.with_fiducials(problem, surface=True), cameras=truth.cameras)
    points, surface = problem.fiducials, problem.surface
    assert points is not None
    assert surface is not None
    seen = np.flatnonzero(points.row < last)
    at_first = SurfaceBasis(surface.at_links[: len(early)], surface.at_fiducials[seen], SIGMA_MM)
    first = replace(
        problem, times_s=TIMES[:last], links=early, component=component[: len(early)],
        fiducials=points.select(seen), surface=at_first,
    )  # fmt: skip
    start = started(problem)
    before = Motion(start.angle[:last], start.shift[:last], start.pivot)
    unknowns = completed(adjust_first_rows(first, before, C))
    assert (unknowns.sums is not None) == ("many" in known)
    if known == "wrong":
        turned = replace(unknowns.motion, angle=unknowns.motion.angle + 0.02 * np.arange(last))
        unknowns = unknowns._replace(motion=turned, surface_mm=unknowns.surface_mm + 2.0)
    assert problem.begins_with(first)
    at_once, begun = adjust(problem, start, C), adjust(problem, start, C, known=unknowns)
    assert np.abs(begun.motion.shift - at_once.motion.shift).max() < 2e-5
    assert begun.similarity == pytest.approx(at_once.similarity, abs=2e-5)


def first_rows_and_all(truth: Bench) -> tuple[Problem, Problem]:
    """Return the problem of all rows but the last one, and that of all rows, whose links stand last."""
    made, last = truth.problem(), ROWS - 1
    evidence = sorted(made.links.groups, key=lambda e: e.rows[1])
    component = made.component[np.argsort(made.links.q, kind="stable")]
    problem = replace(made, links=to_observations(evidence, truth.cameras), component=component)
    problem = replace(truth.with_fiducials(problem), cameras=truth.cameras)
    early, points = to_observations([e for e in evidence if e.rows[1] < last], truth.cameras), problem.fiducials
    assert points is not None
    seen = points.select(np.flatnonzero(points.row < last))
    first = replace(problem, times_s=TIMES[:last], links=early, component=component[: len(early)], fiducials=seen)
    return first, problem


def test_a_last_row_that_moves_nothing_is_still_weighed_by_the_noise_of_all_links(
    bench: Any, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The first step has the sum of the earlier links only, without their noise floors and their influence."""
    monkeypatch.setattr(adjustment, "_SAMPLE_LINKS", 150)
    monkeypatch.setattr(adjustment, "_PER_ROW", 25)
    first, problem = first_rows_and_all(replace(bench(5), real_px=1e-4, pair_px=0.0))
    start, last = started(problem), ROWS - 1
    known = completed(adjust_first_rows(first, Motion(start.angle[:last], start.shift[:last], start.pivot), C))
    assert known.sums is not None
    at_once = adjust(problem, start, C)
    begun = adjust(problem, start, C, known=known, converged_mm=1e-2)
    assert begun.floor_px == pytest.approx(at_once.floor_px, rel=0.1)
    assert begun.sigma0 == pytest.approx(at_once.sigma0, rel=0.1)


def test_a_problem_does_not_begin_with_as_many_other_links(bench: Any) -> None:
    """Links off the board are left out by C, which moves with the last row: one more on the left, one less beyond."""
    problem = bench(5).problem()
    every = np.arange(len(problem.links))
    whole, first = problem.select(every[1:]), problem.select(every[1:-40])
    assert whole.begins_with(replace(first, links=replace(first.links, groups=first.links.groups[:-1])))
    other = problem.select(np.delete(every, 5))
    assert not other.begins_with(replace(first, links=replace(first.links, groups=first.links.groups[:-1])))
