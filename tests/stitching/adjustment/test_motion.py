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


def test_the_nominal_belt_moves_at_its_velocity() -> None:
    times = np.array([2.0, 2.1, 2.3])
    motion = nominal_motion(times, np.array([0.0, 100.0]), np.array([40.0, 0.0]))
    np.testing.assert_allclose(motion.row_from_tester(2).matrix, [[1, 0, 0], [0, 1, 30], [0, 0, 1]], atol=1e-9)
    assert measured_velocity(motion, times, np.array([0, 1, 2])) == pytest.approx([0, 100])
    assert measured_velocity(motion, times, np.array([1, 2])) == pytest.approx([0, 100])
    assert measured_velocity(motion, times, np.array([1])) is None


def test_a_belt_at_nominal_velocity_has_no_residual() -> None:
    times, velocity = np.array([0.0, 0.1, 0.25]), np.array([30.0, 40.0])
    columns, a, b = belt_equations(nominal_motion(times, velocity, np.zeros(2)), times, velocity, np.ones(2, np.bool_))
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
    columns, a, b = belt_equations(moved, times, velocity, np.zeros(1, np.bool_))
    assert columns.tolist() == [[0, 1, 2, 3, 4, 5]]
    assert np.abs(b[0]) == pytest.approx(sigma, abs=1e-9)
    change = np.concatenate([[0, 0, 0], [angle, x, y]])
    assert a[0] @ change == pytest.approx(b[0], abs=1e-9), "the Jacobian of a linear residual"
