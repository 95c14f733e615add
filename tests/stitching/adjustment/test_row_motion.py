"""The motion of the rows from links, or from marks, before the board is found."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.stitching.adjustment.motion import measure_step, nominal_motion
from vaoi_station.stitching.adjustment.problem import Observations, Problem, to_observations
from vaoi_station.stitching.adjustment.row_motion import (
    board_texture,
    chain_steps,
    connected_rows,
    mark_links,
    measured_steps,
    motion_from_links,
    motion_from_marks,
)
from vaoi_station.stitching.matching.evidence import Detections, Links, Task

TIMES, VELOCITY = np.array([0.0, 0.1, 0.2, 0.3]), np.array([0.0, 40.0])
NOMINAL = nominal_motion(TIMES, VELOCITY, np.zeros(2))
BELT = nominal_motion(np.array([0.0, 0.1, 0.2]), np.array([0.0, 50.0]), np.zeros(2))
STEP_PX = 50.0
MARKS = np.array([[30.0, 20.0], [90.0, 25.0], [150.0, 22.0]])
MOVED_PX = np.array([[0.0, 0.0], [0.5, 41.0], [0.2, 79.5], [-0.4, 121.0]])


def problem(camera: Any, count: int, outliers: int = 0) -> Problem:
    """Links between consecutive rows whose motion is MOVED_PX; the first ones are off by 2 mm."""
    g, found = np.random.default_rng(1), []
    for row in range(3):
        a = g.uniform(20, 140, (count, 2))
        b = a + MOVED_PX[row + 1] - MOVED_PX[row] + g.normal(0, 0.05, (count, 2))
        b[:outliers] += 20.0
        information = np.tile(np.eye(2) / 0.05**2, (count, 1, 1))
        found.append(Links(Task("rows", (0, row), (0, row + 1), 0.1), a, b, information, np.ones(count)))
    links = to_observations(found, (camera,))
    return Problem(TIMES, VELOCITY, links, np.full(len(links), -1))


def test_links_give_the_motion_although_a_third_of_them_is_wrong(workshop: Any) -> None:
    camera = workshop.camera()
    given = problem(camera, 60, outliers=20)
    moved = motion_from_links(given, NOMINAL)
    assert moved.motion.shift * -camera.px_per_mm == pytest.approx(MOVED_PX, abs=0.05)
    assert moved.result.motion.shift * -camera.px_per_mm == pytest.approx(MOVED_PX, abs=0.05)


@pytest.mark.parametrize("turn", [0.0, 2e-3])
def test_a_step_is_measured_with_its_turn_and_its_scatter(turn: float) -> None:
    g = np.random.default_rng(5)
    k, c, s = 200, np.cos(turn), np.sin(turn)
    b = g.uniform(-100, 100, (k, 2))
    a = b @ np.array([[c, s], [-s, c]]) + (0.3, -40.0) + g.normal(0, 0.004, (k, 2))
    a[:20] += g.uniform(-3, 3, (20, 2))
    one = measure_step(3, 5, a, b, np.tile(np.eye(2) * 1e-6, (k, 1, 1)), np.full(k, 20.0), np.ones(k))
    assert (one.p, one.q) == (3, 5)
    assert one.turn == pytest.approx(turn, abs=2e-5)
    assert abs(one.a_mm - np.exp(1j * turn) * one.b_mm - (0.3 - 40j)) < 0.002
    assert one.floor_mm == pytest.approx(0.004, rel=0.2)
    assert one.weight == pytest.approx(180 / 0.004**2, rel=0.4)


def test_a_single_link_gives_a_shift_and_no_turn() -> None:
    at = np.array([[30.0, 4.0]])
    one = measure_step(0, 1, at, at + (0.0, 5.0), np.eye(2)[None] * 1e-6, np.array([20.0]), np.ones(1))
    assert (one.turn, one.turn_weight, one.b_mm - one.a_mm) == (0.0, 0.0, 5j)


def test_steps_over_two_rows_reduce_the_error_of_a_doubtful_step(workshop: Any) -> None:
    """Rows 1 and 2 are linked by three links that are wrong by 0.5 mm; rows 0 and 2, and 1 and 3, by many."""
    right = {(0, 1): 4.0, (1, 2): 4.0, (2, 3): 4.0, (0, 2): 8.0, (1, 3): 8.0}
    camera, at = workshop.camera(), np.array([[20.0 * k, 60.0 + 3 * k] for k in range(9)])
    found = []
    for (p, q), step in sorted(right.items(), key=lambda e: (e[0][1], e[0][0])):
        count, wrong = (3, 0.5) if (p, q) == (1, 2) else (9, 0.0)
        own = at[:count]
        information = np.tile(np.eye(2) * (1.0 if wrong else 400.0), (count, 1, 1))
        found.append(
            Links(Task("rows", (0, p), (0, q)), own, own + (0, 10 * (step + wrong)), information, np.ones(count))
        )
    links = to_observations(found, (camera,))
    given = Problem(TIMES, VELOCITY, links, np.full(len(links), -1))
    shift = motion_from_links(given, NOMINAL).motion.shift[:, 1]
    assert shift == pytest.approx([0, -4, -8, -12], abs=0.02)


def test_the_texture_of_the_board_leaves_outliers_out_and_is_a_sample(workshop: Any) -> None:
    camera = workshop.camera()
    given = problem(camera, 60, outliers=10)
    texture = board_texture(given.links, motion_from_links(given, NOMINAL))
    assert 100 <= len(texture) <= 150
    many = problem(camera, 6000)
    assert 3900 <= len(board_texture(many.links, motion_from_links(many, NOMINAL))) < 8000


def detections(camera: int, row: int, px: NDArray[np.float64], kind: list[int] | None = None) -> Detections:
    k = len(px)
    kinds = np.array(kind if kind is not None else [0] * k, dtype=np.int_)
    return Detections(Task("marks", (camera, row)), px, np.full(k, 0.02), np.full(k, 0.9), kinds)


def test_marks_give_the_motion_without_links(workshop: Any) -> None:
    camera = workshop.camera()
    at = np.array([[30.0, 10.0], [100.0, 15.0], [170.0, 12.0]])
    none = Problem(TIMES, VELOCITY, to_observations([], (camera,)), np.zeros(0, dtype=np.int_))
    seen = [detections(0, row, at + MOVED_PX[row]) for row in range(4)]
    moved = motion_from_marks(none, NOMINAL, seen, (camera,))
    assert moved.motion.shift * -camera.px_per_mm == pytest.approx(MOVED_PX, abs=0.1)


def test_an_ambiguous_mark_is_not_linked(workshop: Any) -> None:
    camera = (workshop.camera(),)
    twice = np.concatenate([MARKS, MARKS[:1] + 2.0])
    for a, b in ((MARKS, twice + (0, STEP_PX)), (twice, MARKS + (0, STEP_PX))):
        (links,) = mark_links([detections(0, 0, a), detections(0, 1, b)], camera, BELT)
        assert sorted(links.a_px[:, 0]) == [90.0, 150.0]


STEADY = nominal_motion(np.array([0.0, 0.1, 0.2, 0.3, 0.4]), np.array([0.0, 50.0]), np.array([0.0, 0.0]))


def chained(camera: Any, steps: dict[tuple[int, int], float], wild: int = 0) -> Observations:
    """Links from row p to row q with these steps in mm along y; the first `wild` of each are wrong."""
    at = np.array([[20.0 * k, 60.0] for k in range(9)])
    found = []
    for (p, q), step in steps.items():
        b = at + (0, 10 * step)
        b[:wild] += (30, -50)
        found.append(Links(Task("rows", (0, p), (0, q)), at, b, np.tile(np.eye(2), (9, 1, 1)), np.ones(9)))
    return to_observations(found, (camera,))


def test_rows_are_chained_by_what_most_of_their_links_show(workshop: Any) -> None:
    seen = chained(workshop.camera(), {(0, 1): 5.5, (1, 2): 4.0, (2, 3): 6.0, (3, 4): 5.0}, wild=4)
    shift = chain_steps(measured_steps(seen), STEADY).shift[:, 1]
    assert shift == pytest.approx([0, -5.5, -9.5, -15.5, -20.5], abs=1e-3)


def test_rows_without_links_follow_the_nominal_belt(workshop: Any) -> None:
    seen = chained(workshop.camera(), {(0, 1): 5.5, (1, 3): 11.0})
    shift = chain_steps(measured_steps(seen), STEADY).shift[:, 1]
    assert shift == pytest.approx([0, -5.5, -10.5, -16.5, -21.5], abs=1e-3)


@pytest.mark.parametrize(
    ("pairs", "groups"),
    [
        ([(0, 1), (1, 2), (2, 3), (3, 4)], [[0, 1, 2, 3, 4]]),
        ([(0, 1), (3, 4)], [[0, 1], [2], [3, 4]]),
        ([(3, 4), (1, 3), (0, 2)], [[0, 2], [1, 3, 4]]),
        ([], [[0], [1], [2], [3], [4]]),
    ],
)
def test_connected_rows_form_groups(workshop: Any, pairs: list[tuple[int, int]], groups: list[list[int]]) -> None:
    seen = chained(workshop.camera(), dict.fromkeys(pairs, 5.0))
    assert [g.tolist() for g in connected_rows(seen, 5, np.ones(len(seen), dtype=bool))] == groups
