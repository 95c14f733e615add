"""The influence of the links of single places and of marks, against adjustments without them."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from tests.stitching.adjustment.test_solver import PX_PER_MM, Bench, C, bench, started
from vaoi_station.stitching.adjustment import influence, solver
from vaoi_station.stitching.adjustment.influence import groups_of_marks, number_clusters
from vaoi_station.stitching.adjustment.observations import LinkArrays, Observations
from vaoi_station.stitching.adjustment.problem import (
    FIXTURE,
    REFERENCE,
    AdjustmentResult,
    FiducialPoints,
    Influence,
    Problem,
)
from vaoi_station.stitching.adjustment.solver import adjust

__all__ = ["bench"]


def first_row_of_few_links(truth: Bench, off_px: float = 0.0) -> Problem:
    """Return a run whose row 0 is connected by two clusters alone; the links of one are off by `off_px` along y."""
    problem = truth.with_fiducials(truth.problem())
    o = problem.links
    of_first = np.flatnonzero(((o.p == 0) | (o.q == 0)) & (o.p != o.q))
    cluster = number_clusters(o.arrays, np.ones(len(o)), 0.1, 5.0)
    numbers, count = np.unique(cluster[of_first], return_counts=True)
    most = numbers[np.argsort(count)[-2:]]
    keep = np.setdiff1d(np.arange(len(o)), of_first[~np.isin(cluster[of_first], most)])
    b_mm = o.b_mm.copy()
    b_mm[cluster == most[1], 1] += off_px / PX_PER_MM
    fiducials = problem.fiducials
    assert fiducials is not None
    # without detections in row 0, links alone connect it
    others = fiducials.select(np.flatnonzero(fiducials.row != 0))
    problem = replace(problem, links=replace(o, b_mm=b_mm), fiducials=others)
    return problem.select(keep)


def first_row_px(change: NDArray[np.float64]) -> NDArray[np.float64]:
    """Return by how much row 0 moves against row 1, px; row 0 is fixed by the gauge, so that row 1 moves."""
    return np.asarray(change[..., 1, 1:3] * PX_PER_MM)


def solved(problem: Problem) -> AdjustmentResult:
    return adjust(problem, started(problem), C)


def examined(problem: Problem) -> tuple[AdjustmentResult, Influence]:
    found = solved(problem)
    assert found.influence is not None
    return found, found.influence


@pytest.fixture
def wide(monkeypatch: pytest.MonkeyPatch) -> None:
    """Examine and keep all; weights, which a change may change too, stay as they are."""
    monkeypatch.setattr(influence, "_FEW", 10**6)
    monkeypatch.setattr(influence, "_LEAST_PX", -1.0)
    monkeypatch.setattr(solver, "_KNEE", 6.0)
    monkeypatch.setattr(solver, "_FLOOR_STEPS", 0)


def test_changes_without_links_are_those_of_an_adjustment_without_them(bench: Any, wide: None) -> None:
    problem = first_row_of_few_links(bench(3))
    found, of = examined(problem)
    cluster = number_clusters(problem.links.arrays, found.weight, 0.1, 5.0)
    assert (~of.of_marks).sum() == cluster.max() + 1
    shift_px = np.abs(first_row_px(of.change)).max(1)
    for number in np.argsort(shift_px[~of.of_marks])[-2:].tolist():
        rest = solved(problem.select(np.flatnonzero(cluster != number)))
        assert rest.similarity is not None
        assert found.similarity is not None
        moved = rest.motion.shift - found.motion.shift
        assert np.abs(moved).max() * PX_PER_MM > 0.01
        assert of.change[number, :, 1:3] == pytest.approx(moved, rel=0.2, abs=2e-4)
        assert of.change[number, 0, 3:7] == pytest.approx(rest.similarity - found.similarity, rel=0.2, abs=2e-4)
        # the covariance of both adjustments with the same noise floor
        grown = rest.covariance[1, 1:3, 1:3] - found.covariance[1, 1:3, 1:3]
        assert of.explained[number, 1, 1:3, 1:3] == pytest.approx(grown, rel=0.3, abs=1e-6)


def test_changes_without_a_mark_are_those_of_an_adjustment_without_it(bench: Any, wide: None) -> None:
    truth = bench(3)
    problem = truth.with_fiducials(truth.problem())
    (found, of), points = examined(problem), problem.fiducials
    assert points is not None
    assert found.similarity is not None
    assert of.of_marks.sum() == 3
    for which, number in enumerate(np.flatnonzero(of.of_marks).tolist()):
        others = points.select(np.flatnonzero(points.which != which))
        rest = solved(replace(problem, fiducials=others))
        assert rest.similarity is not None
        assert np.sqrt(3) * of.change[number, 0, 3:7] == pytest.approx(
            rest.similarity - found.similarity, rel=0.1, abs=4e-4
        )
        grown = np.sqrt(np.diag(rest.covariance[1] - found.covariance[1])[3:7])
        explained = np.sqrt(3 * np.diag(of.explained[number, 1])[3:7]) / influence._MARK_SIGMAS
        assert explained == pytest.approx(grown, rel=0.1, abs=1e-6)


def beyond_noise_px(of: Influence) -> float:
    """Return the largest part of the shifts of row 1 that the growth of its covariance does not explain, px."""
    shift, growth = first_row_px(of.change), of.explained[:, 1, 1:3, 1:3] * PX_PER_MM**2
    values = np.linalg.eigvalsh(shift[:, :, None] * shift[:, None] - growth)
    return float(np.sqrt(np.maximum(values, 0).max()))


def test_places_that_disagree_move_a_row_by_more_than_noise(bench: Any) -> None:
    """Two clusters place row 0, and are 0.25 px apart: nothing shows which of them is right."""
    agree, disagree = [], []
    for seed in range(10, 22):
        agree.append(beyond_noise_px(examined(first_row_of_few_links(bench(seed)))[1]))
        disagree.append(beyond_noise_px(examined(first_row_of_few_links(bench(seed), off_px=0.25))[1]))
    print("beyond noise, px:", np.round(agree, 3), np.round(disagree, 3))
    assert max(agree) < 0.05 < min(disagree)
    assert np.median(disagree) > 0.1


def test_many_places_are_not_examined(bench: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    truth = bench(4)
    problem = truth.with_fiducials(truth.problem())
    o = problem.links
    # those at seams are left out: only the places that connect rows count here
    between = problem.select(np.flatnonzero(o.p != o.q))
    clusters = number_clusters(between.links.arrays, np.ones(len(between.links)), 0.1, 5.0)
    of_row = [len(np.unique(clusters[(between.links.p == row) | (between.links.q == row)])) for row in range(6)]
    monkeypatch.setattr(influence, "_LEAST_PX", 0.0)
    for few, examines in ((min(of_row) - 1, False), (max(of_row), True)):
        monkeypatch.setattr(influence, "_FEW", few)
        found = solved(between).influence
        assert found is not None
        assert (~found.of_marks).any() == examines


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
    assert max(right) < 0.01
    assert min(wrong) > 0.02


def cad_beyond_noise_mm(of: Influence | None) -> float:
    """Return the largest part of the changes of C's shift without one mark that noise does not explain, mm."""
    if of is None:
        return 0.0
    shift, explained = of.change[of.of_marks, 0, 5:7], of.explained[of.of_marks][:, 0, 5:7, 5:7]
    values = np.linalg.eigvalsh(shift[:, :, None] * shift[:, None] - explained)
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
    k, pairs = len(which), np.zeros((len(which), 2))
    sigma_mm, number = np.full(k, 0.001), np.array(which, np.int_)
    points = FiducialPoints(number, pairs, pairs, pairs, sigma_mm, np.full(k, 10.0), number, number)
    assert [g.tolist() for g in groups_of_marks(points)] == groups
    # Fiducials of single boards of a panel do not place the panel.
    of_boards = replace(points, which=number[::-1] + 10, sigma_mm=np.full(k, 0.5))
    assert [g.tolist() for g in groups_of_marks(FiducialPoints.joined([points, of_boards]))] == groups


def test_without_c_or_links_nothing_is_examined(bench: Any) -> None:
    truth = bench(5)
    problem = first_row_of_few_links(truth)
    assert adjust(replace(problem, fiducials=None), started(problem)).influence is None
    none = np.zeros(0, np.int_)
    assert adjust(problem.select(none), started(problem), C).influence is None


@given(
    st.lists(
        st.tuples(st.integers(0, 3), st.floats(-30, 30), st.floats(-30, 30), st.sampled_from([0.0, 0.05, 0.5, 1.0])),
        max_size=40,
    )
)
def test_clusters_are_the_used_links_of_one_pair_in_one_square(links: list[tuple[int, float, float, float]]) -> None:
    links = sorted(links, key=lambda link: link[0])
    empty = Observations.empty().arrays
    group = np.array([link[0] for link in links], np.int_)
    b_mm = np.array([link[1:3] for link in links]).reshape(-1, 2)
    weight = np.array([link[3] for link in links], np.float64)
    arrays: LinkArrays = empty._replace(group=group, b_mm=b_mm)
    cluster = number_clusters(arrays, weight, 0.1, 5.0)
    key = [(g, x // 5, y // 5) for g, x, y, w in links]
    for n in range(len(links)):
        assert (cluster[n] < 0) == (weight[n] <= 0.1)
        for m in range(n):
            if min(weight[n], weight[m]) > 0.1:
                assert (cluster[n] == cluster[m]) == (key[n] == key[m])
    used = cluster[cluster >= 0]
    assert sorted(set(used.tolist())) == list(range(len(set(used.tolist()))))
