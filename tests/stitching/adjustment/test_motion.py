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
