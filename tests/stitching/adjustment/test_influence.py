"""The influence of the links of single places and of marks, against adjustments without them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from tests.stitching.adjustment.test_solver import PX_PER_MM, Bench, C, bench, started
from vaoi_station.stitching.adjustment import influence, solver
from vaoi_station.stitching.adjustment.envelope import NormalEquations
from vaoi_station.stitching.adjustment.equations import HeightEquations, LinkState
from vaoi_station.stitching.adjustment.influence import Assembly, few_places, groups_of_marks, solve
from vaoi_station.stitching.adjustment.problem import (
    FIXTURE,
    REFERENCE,
    AdjustmentResult,
    FiducialPoints,
    Influence,
    LinkArrays,
    Observations,
    Problem,
)
from vaoi_station.stitching.adjustment.solver import adjust

__all__ = ["bench"]
Array = NDArray[np.float64]
Ints = NDArray[np.int_]


def squares(links: Observations, offset_mm: tuple[float, float]) -> list[Ints]:
    """Return the links of each pair of frames within each square of 4 mm; the grid is displaced by `offset_mm`."""
    at = np.floor((links.b_mm + offset_mm) / 4.0).astype(int)
    each = np.unique(np.column_stack([links.group, at]), axis=0, return_inverse=True)[1].ravel()
    return [np.flatnonzero(each == number) for number in range(each.max() + 1)]


def few_links_after(
    truth: Bench, gap: int, *, off_px: float = 0.0, offset_mm: tuple[float, float] = (0.0, 0.0)
) -> Problem:
    """Return a run in which two places alone connect row `gap` with the next one; one of them is off along y."""
    problem = truth.with_fiducials(truth.problem())
    o = problem.links
    across = np.flatnonzero((o.p == gap) & (o.q == gap + 1))
    own = [at for at in squares(o, offset_mm) if at[0] in across]
    places = sorted(own, key=len)[-2:]
    b_mm = o.b_mm.copy()
    b_mm[places[1], 1] += off_px / PX_PER_MM
    points = problem.fiducials
    assert points is not None
    # without detections before the gap, links alone connect these rows
    later = points.select(np.flatnonzero(points.row > gap))
    problem = replace(problem, links=replace(o, b_mm=b_mm), fiducials=later)
    return problem.select(np.setdiff1d(np.arange(len(o)), np.setdiff1d(across, np.concatenate(places))))


def solved(problem: Problem) -> AdjustmentResult:
    return adjust(problem, started(problem), C)


def examined(problem: Problem) -> tuple[AdjustmentResult, Influence]:
    found = solved(problem)
    assert found.influence is not None
    return found, found.influence


def assembly_of(problem: Problem, monkeypatch: pytest.MonkeyPatch) -> tuple[Assembly, int]:
    """Return the equations of a problem at its solution, and the number of unknowns that are not held."""
    taken: list[Any] = []

    def take(*arguments: Any) -> None:
        taken.append(arguments)

    monkeypatch.setattr(solver, "examine_influence", take)
    solved(problem)
    ((assembly, *_, shared),) = taken
    return assembly, 3 * len(assembly.motion.angle) + shared


@pytest.fixture
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    """Examine and keep all; weights, which a change may change too, stay as they are."""
    monkeypatch.setattr(influence, "_FEW", 10**6)
    monkeypatch.setattr(influence, "_FEW_AT_SEAM", 10**6)
    monkeypatch.setattr(influence, "_LEAST_PX", -1.0)
    monkeypatch.setattr(solver, "_KNEE", 6.0)
    monkeypatch.setattr(solver, "_FLOOR_STEPS", 0)


def test_equations_without_a_group_are_those_of_the_rest(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    """With a surface, component heights and cameras that may have moved."""
    truth = bench(3, surface=(0.3, 0.05, 0.0, 0.1, 0.0, 0.0), heights=(1.5, 0.8, 2.0))
    problem = replace(truth.with_fiducials(truth.problem(), surface=True), cameras=truth.cameras)
    assembly, count = assembly_of(problem, monkeypatch)
    model = assembly.model

    def solution(normal: NormalEquations, heights: HeightEquations) -> Array:
        return solve(assembly.without_heights(normal, heights, count))

    whole = assembly.whole()
    monkeypatch.setattr(influence, "_FEW", 10**6)
    places = few_places(assembly.links, assembly.state, len(problem.times_s))
    assert len(places) > 30
    for at in (place.links for place in places[::30]):
        rest = np.setdiff1d(np.arange(len(assembly.links.p)), at)
        others = replace(
            assembly,
            links=LinkArrays._make(values[rest] for values in assembly.links),
            state=LinkState._make(values[rest] for values in assembly.state),
            model=model._replace(basis=model.basis[rest], component=model.component[rest]),
        )
        part = assembly.part(at)
        without, direct = solution(whole[0].less(part[0]), whole[1].less(part[1])), solution(*others.whole())
        assert without == pytest.approx(direct, rel=1e-6, abs=1e-9)
    assert problem.fiducials is not None
    for at in groups_of_marks(problem.fiducials):
        rest = np.setdiff1d(np.arange(len(problem.fiducials.row)), at)
        detections = (assembly.priors[1][0][rest], assembly.priors[1][1][rest], assembly.priors[1][2][rest])
        others = replace(assembly, priors=[assembly.priors[0], detections, *assembly.priors[2:]])
        rest_of_all = assembly.without_heights(*whole, count).less(assembly.part_of_marks(at, count))
        without, direct = solve(rest_of_all), solution(*others.whole())
        assert without == pytest.approx(direct, rel=1e-6, abs=1e-9)


def test_changes_without_a_mark_are_those_of_an_adjustment_without_it(bench: Any, wide: None) -> None:
    truth = bench(3)
    problem = truth.with_fiducials(truth.problem())
    (found, of), points = examined(problem), problem.fiducials
    assert points is not None
    assert found.similarity is not None
    assert of.of_marks.sum() == of.marks == 3
    for which, number in enumerate(np.flatnonzero(of.of_marks).tolist()):
        rest = solved(replace(problem, fiducials=points.select(np.flatnonzero(points.which != which))))
        assert rest.similarity is not None
        assert of.change[number, 0, 3:7] == pytest.approx(rest.similarity - found.similarity, rel=0.1, abs=2e-4)
        grown = np.diag(rest.covariance[1] - found.covariance[1])[3:7]
        assert np.diag(of.growth[number, 1])[3:7] == pytest.approx(grown, rel=0.2, abs=1e-8)


def beyond_noise_px(of: Influence, row: int) -> float:
    """Return the largest part of the shifts of a row that the growth of its covariance does not explain, px."""
    shift, growth = of.change[:, row, 1:3] * PX_PER_MM, of.growth[:, row, 1:3, 1:3] * PX_PER_MM**2
    values = np.linalg.eigvalsh(shift[:, :, None] * shift[:, None] - growth)
    return float(np.sqrt(np.maximum(values, 0).max()))


@pytest.mark.parametrize("gap", [0, 2])
@pytest.mark.parametrize("offset_mm", [(0.0, 0.0), (1.3, 3.1)])
def test_places_that_disagree_move_rows_by_more_than_noise(
    bench: Any, gap: int, offset_mm: tuple[float, float]
) -> None:
    """Two places connect the rows beside a gap, and are 0.25 px apart, wherever they lie in the grid of clusters."""
    agree: list[float] = []
    disagree: list[float] = []
    for seed in range(10, 18):
        for off_px, found in ((0.0, agree), (0.25, disagree)):
            result = solved(few_links_after(bench(seed), gap, off_px=off_px, offset_mm=offset_mm)).influence
            found.append(0.0 if result is None else beyond_noise_px(result, gap + 1))
    print("beyond noise, px:", np.round(agree, 3), np.round(disagree, 3))
    assert np.median(disagree) > max(3 * np.median(agree), 0.06)


def test_a_mark_that_is_not_where_the_cad_data_have_it_has_an_influence_beyond_noise(bench: Any) -> None:
    """Three fiducials, of which one is off by 1 px in the CAD data: nothing shows which."""
    right, wrong = [], []
    for seed in range(30, 36):
        truth = bench(seed)
        problem = truth.with_fiducials(truth.problem())
        right.append(cad_beyond_noise_mm(solved(problem).influence))
        points = problem.fiducials
        assert points is not None
        cad = points.cad + 1.0 / PX_PER_MM * np.array([0.6, 0.8]) * (points.which == 1)[:, None]
        wrong.append(cad_beyond_noise_mm(solved(replace(problem, fiducials=replace(points, cad=cad))).influence))
    print("beyond noise, mm:", np.round(right, 4), np.round(wrong, 4))
    assert max(right) < 0.02
    assert min(wrong) > 0.05


def cad_beyond_noise_mm(of: Influence | None) -> float:
    """Return the largest part of the changes of C's shift without one mark that 2 σ of noise do not explain, mm."""
    if of is None:
        return 0.0
    shift, growth = of.change[of.of_marks, 0, 5:7], of.growth[of.of_marks][:, 0, 5:7, 5:7]
    values = np.linalg.eigvalsh(shift[:, :, None] * shift[:, None] - 4 * growth)
    return float(np.sqrt(np.maximum(values, 0).max(initial=0)))


@pytest.mark.parametrize(
    ("which", "groups"),
    [
        ([0, 1, 0, 1], []),  # two fiducials: without one of them, nothing places the board
        ([0, 1, 2, 0], [[0, 3], [1], [2]]),
        ([0, 1, REFERENCE, REFERENCE], [[2, 3], [0], [1]]),
        ([FIXTURE, FIXTURE, 0], [[2]]),
        ([REFERENCE, REFERENCE], []),
        ([], []),
    ],
)
def test_marks_are_left_out_where_others_place_the_board(which: list[int], groups: list[list[int]]) -> None:
    k, pairs, number = len(which), np.zeros((len(which), 2)), np.array(which, np.int_)
    # Links to a reference on one part have an error in common, and each a larger σ.
    sigma_mm = np.where(number == REFERENCE, 0.2, 0.001)
    points = FiducialPoints(number, pairs, pairs, pairs, sigma_mm, np.full(k, 10.0), number, number)
    assert [g.tolist() for g in groups_of_marks(points)] == groups
    # Fiducials of single boards of a panel do not place the panel.
    of_boards = replace(points, which=np.arange(k) + 10, sigma_mm=np.full(k, 0.5))
    assert [g.tolist() for g in groups_of_marks(FiducialPoints.joined([points, of_boards]))] == groups
