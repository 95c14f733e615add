"""The motion of the rows: both directions, the gauge, and the nominal belt."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.stitching.adjustment.motion import (
    Motion,
    belt_equations,
    measured_velocity,
    nominal_motion,
    points_in_box,
)

mm = st.floats(-300, 300)
rows = st.lists(st.tuples(st.floats(-0.1, 0.1), mm, mm), min_size=1, max_size=6)


def motion_of(values: list[tuple[float, float, float]], pivot: tuple[float, float]) -> Motion:
    v = np.array(values)
    return Motion(np.ascontiguousarray(v[:, 0]), v[:, 1:], np.array(pivot))


@given(rows, st.tuples(mm, mm), st.lists(st.tuples(mm, mm), min_size=1, max_size=4))
def test_board_and_row_transforms_are_inverse(
    values: list[tuple[float, float, float]], pivot: tuple[float, float], points: list[tuple[float, float]]
) -> None:
    motion, p = motion_of(values, pivot), np.array(points)
    for j in range(len(values)):
        there = motion.row_from_tester(j)(p)
        np.testing.assert_allclose(motion.board(np.full(len(p), j), there), p, atol=1e-9)


@given(rows, st.tuples(mm, mm))
def test_in_gauge_the_first_row_is_the_identity_and_relative_motions_stay(
    values: list[tuple[float, float, float]], pivot: tuple[float, float]
) -> None:
    motion = motion_of(values, pivot)
    gauged = motion.in_gauge()
    np.testing.assert_allclose(gauged.row_from_tester(0).matrix, np.eye(3), atol=1e-9)
    first = motion.row_from_tester(0).inverse().matrix
    for j in range(len(values)):
        expected = motion.row_from_tester(j).matrix @ first
        np.testing.assert_allclose(gauged.row_from_tester(j).matrix, expected, atol=1e-9)
    np.testing.assert_allclose(gauged.in_gauge().shift, gauged.shift, atol=1e-9)


@given(st.floats(-0.5, 0.5), st.tuples(mm, mm))
def test_directions_rotate_with_the_board(angle: float, arrow: tuple[float, float]) -> None:
    motion = Motion(np.array([0.0, angle]), np.array([[0.0, 0], [5, 7]]), np.array([3.0, 4]))
    row, a = np.array([1]), np.array([arrow])
    both = motion.board(row, motion.pivot + a) - motion.board(row, np.array([motion.pivot]))
    np.testing.assert_allclose(motion.turned(row, a), both, atol=1e-9)


def test_the_nominal_belt_moves_at_its_velocity() -> None:
    times = np.array([2.0, 2.1, 2.3])
    motion = nominal_motion(times, np.array([0.0, 100.0]), np.array([40.0, 0.0]))
    np.testing.assert_allclose(motion.row_from_tester(2).matrix, [[1, 0, 0], [0, 1, 30], [0, 0, 1]], atol=1e-9)
    assert measured_velocity(motion, times, np.array([0, 1, 2])) == pytest.approx([0, 100])
    assert measured_velocity(motion, times, np.array([1, 2])) == pytest.approx([0, 100])
    assert measured_velocity(motion, times, np.array([1])) is None


@given(rows, st.lists(st.tuples(mm, mm), max_size=6), st.tuples(mm, mm), st.tuples(mm, mm))
def test_points_in_a_box_are_those_that_a_row_moves_into_it(
    values: list[tuple[float, float, float]],
    points: list[tuple[float, float]],
    corner: tuple[float, float],
    other: tuple[float, float],
) -> None:
    motion, board = motion_of(values, (0.0, 0.0)), np.array(points).reshape(-1, 2)
    low, high = np.minimum(corner, other), np.maximum(corner, other)
    row, point, place = points_in_box(motion.rows_from_tester, board, low, high)
    found = dict(zip(zip(row.tolist(), point.tolist(), strict=True), place, strict=True))
    assert list(found) == sorted(found), "row by row"
    for j in range(len(values)):
        there = motion.row_from_tester(j)(board)
        margin = np.minimum(there - low, high - there).min(1) if len(board) else np.zeros(0)
        for n, (at, inside) in enumerate(zip(there, margin, strict=True)):
            if abs(inside) > 1e-6:  # at the edge of the box rounding decides
                assert ((j, n) in found) == (inside > 0)
            if (j, n) in found:
                np.testing.assert_allclose(found[j, n], at, atol=1e-8)


def test_a_belt_at_nominal_velocity_has_no_residual() -> None:
    times, velocity = np.array([0.0, 0.1, 0.25]), np.array([30.0, 40.0])
    columns, a, b = belt_equations(nominal_motion(times, velocity, np.zeros(2)), times, velocity)
    np.testing.assert_allclose(b, 0, atol=1e-12)
    whole = np.zeros((6, 9))
    for n in range(2):
        whole[3 * n : 3 * n + 3, columns[n]] = a[n]
    assert np.linalg.matrix_rank(whole) == 6, "the first row is free"


@pytest.mark.parametrize(
    ("deviation", "sigma"),
    [((0.0, 0.02 * 5 + 0.01, 0.0), (1, 0, 0)), ((0.15, 0.0, 0.0), (0, 1, 0)), ((0.0, 0.0, 0.003), (0, 0, 1))],
)
def test_one_standard_deviation_along_across_and_in_rotation(
    deviation: tuple[float, float, float], sigma: tuple[float, float, float]
) -> None:
    """The belt moves 5 mm along y per step; its second row deviates from that by x, y in mm and an angle."""
    times, velocity = np.array([0.0, 0.1]), np.array([0.0, 50.0])
    motion = nominal_motion(times, velocity, np.zeros(2))
    x, y, angle = deviation
    moved = replace(motion, shift=motion.shift + [[0, 0], [x, y]], angle=np.array([0.0, angle]))
    columns, a, b = belt_equations(moved, times, velocity)
    assert columns.tolist() == [[0, 1, 2, 3, 4, 5]]
    assert np.abs(b[0]) == pytest.approx(sigma, abs=1e-9)
    change = np.concatenate([[0, 0, 0], [angle, x, y]])
    assert a[0] @ change == pytest.approx(b[0], abs=1e-9), "the Jacobian of a linear residual"
