"""Which good frames are confirmed by links on the board, and by what lies beside it."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from tests.hostile.judging import judge
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.problem import REFERENCE, FiducialPoints, Observations
from vaoi_station.stitching.matching.evidence import Links, Task
from vaoi_station.stitching.quality.confirmation import (
    confirmed_beside,
    confirmed_by_links,
    confirmed_by_points,
    linked_to_before,
)

STEP_MM = 10.0
MOTION = Motion(np.zeros(3), np.array([(0.0, 0.0), (-STEP_MM, 0.0), (-2 * STEP_MM, 0.0)]), np.zeros(2))
"""The board is carried 10 mm along x from row to row."""


def observed(*pairs: tuple[Task, Floats]) -> Observations:
    """Return links of pairs of frames, each with the way (k, 2) between its two points, mm."""
    count = [len(way) for _, way in pairs]
    a_mm = np.concatenate([np.linspace((0, 0), (5, 40), len(way)) for _, way in pairs])
    way_mm = np.concatenate([way for _, way in pairs])
    group = np.repeat(np.arange(len(pairs)), count)
    p = np.array([task.a[1] for task, _ in pairs])[group]
    q = np.array([(task.b or task.a)[1] for task, _ in pairs])[group]
    zero = np.zeros_like(a_mm)
    empty = tuple(Links.empty(task, "") for task, _ in pairs)
    noise, ones = np.zeros((len(a_mm), 2, 2)), np.ones(len(a_mm))
    return Observations(p, q, a_mm, a_mm + way_mm, zero, zero, noise, ones, ones, group, empty)


def ways(*mm: float) -> Floats:
    return np.array([(x, 0.0) for x in mm])


ROWS = Task("rows", (0, 0), (0, 1))


def test_a_frame_is_linked_to_the_one_before_by_used_links_of_its_camera() -> None:
    """Links over two rows or to another camera do not show that it is no repetition, and neither do rejected ones."""
    tasks = ROWS, Task("rows", (0, 0), (0, 2)), Task("neighbours", (0, 1), (1, 1)), Task("rows", (1, 0), (1, 1))
    links = observed(*((task, ways(STEP_MM, STEP_MM)) for task in tasks))
    assert linked_to_before(links, np.array([1, 1, 1, 1, 1, 1, 0.05, 0])) == {(0, 1)}
    assert linked_to_before(links, np.array([0, 1, 1, 1, 1, 1, 0.2, 0])) == {(0, 1), (1, 1)}


@pytest.mark.parametrize(
    ("weight", "confirmed", "decided"),
    [
        ([1.0] * 2, False, False),
        ([1.0] * 3, True, False),
        ([1.0] * 3 + [0.0] * 9, False, True),
        ([1.0] * 7 + [0.0] * 24, False, True),  # as many fit by chance in a picture of the row before
        ([1.0] * 7 + [0.0] * 7, True, True),
        ([0.0] * 5, False, True),
    ],
)
def test_a_number_or_a_share_of_links_must_fit(weight: list[float], confirmed: bool, decided: bool) -> None:
    links = observed((ROWS, ways(*[STEP_MM] * len(weight))))
    both = {(0, 0), (0, 1)}
    assert confirmed_by_links(links, np.array(weight)) == (both if confirmed else set(), both if decided else set())


@pytest.mark.parametrize(
    ("which", "residual_px", "confirmed", "decided"),
    [
        ([0], [0.01], True, False),  # one mark of the board
        ([0], [50.0], False, False),
        ([REFERENCE] * 2, [0.01] * 2, False, False),
        ([REFERENCE] * 6, [0.01] * 3 + [50.0] * 3, True, True),
        ([REFERENCE] * 6, [0.01] * 2 + [50.0] * 4, False, True),
        ([0] + [REFERENCE] * 6, [0.01] + [50.0] * 6, True, True),
    ],
)
def test_points_confirm_a_frame_by_their_residuals(
    which: list[int], residual_px: list[float], confirmed: bool, decided: bool
) -> None:
    count = len(which)
    points = replace(
        FiducialPoints.empty(), row=np.full(count, 3), camera=np.full(count, 1), which=np.array(which),
        sigma_mm=np.full(count, 0.001), px_per_mm=np.full(count, 20.0),
    )  # fmt: skip
    found = confirmed_by_points(points, np.column_stack([residual_px, np.zeros(count)]))
    assert found == ({(1, 3)} if confirmed else set(), {(1, 3)} if decided else set())


@pytest.mark.parametrize(
    ("way_mm", "confirmed"),
    [
        (STEP_MM, True),
        (STEP_MM * 0.985, True),  # a carrier below the board
        (0.0, False),  # the picture of the row before, or dirt on the lens
        (2 * STEP_MM, False),  # the picture of a later row
        (STEP_MM * 0.9, False),
    ],
)
def test_a_carrier_confirms_a_frame_only_if_it_moves_with_the_board(way_mm: float, confirmed: bool) -> None:
    beside = observed((ROWS, ways(*[way_mm] * 8)))
    found = confirmed_beside(beside, MOTION, {(0, 0)})
    assert found == ({(0, 0)} if confirmed else set()), "only frames that are asked for are named"


def test_few_links_beside_the_board_and_links_between_cameras_confirm_nothing() -> None:
    few = observed((ROWS, ways(*[STEP_MM] * 4)))
    assert confirmed_beside(few, MOTION, {(0, 0)}) == set()
    mixed = observed((ROWS, ways(*[STEP_MM] * 6, *[0.0] * 4)))
    assert confirmed_beside(mixed, MOTION, {(0, 0)}) == set()
    neighbours = observed((Task("neighbours", (0, 0), (1, 0)), ways(*[0.0] * 20)))
    assert confirmed_beside(neighbours, MOTION, {(0, 0)}) == set()
    assert confirmed_beside(Observations.empty(), MOTION, {(0, 0)}) == set()


def test_links_along_an_edge_beside_the_board_confirm_nothing() -> None:
    """They fit by chance: along the edge, each is off by another amount, within the limit for what lies lower."""
    along = np.column_stack([np.full(8, STEP_MM), (-0.1, -0.08, 0.0, 0.16, 0.18, 0.19, 0.24, 0.24)])
    assert confirmed_beside(observed((ROWS, along)), MOTION, {(0, 0)}) == set()
    alike = np.column_stack([np.full(8, STEP_MM), np.linspace(0.18, 0.24, 8)])
    assert confirmed_beside(observed((ROWS, alike)), MOTION, {(0, 0)}) == {(0, 0)}


def test_a_copy_is_not_confirmed_by_the_edge_of_a_carrier() -> None:
    """A frame shows the moment of the one before it; 7 of 8 links along an edge fit (hostile seed 90096)."""
    assert judge(90096).finds == ()


def test_a_frame_that_shows_almost_only_the_carrier_is_no_reason() -> None:
    """The first frame of camera 0 shows five components, but all its links lie on the carrier (hostile seed 71014)."""
    outcome = judge(71014)
    assert (outcome.status, outcome.finds) == ("ok", ()), outcome.reasons
