"""The compiled kernels against the equations written with NumPy, one step after the other."""

from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from vaoi_station.geometry.projection_kernels import (
    LensShape,
    distort_points,
    ground_to_image,
    image_to_ground,
    transfer_points,
    undistort_points,
)
from vaoi_station.geometry.transforms import Floats, apply

SHAPE: LensShape = (695.5, 519.5, 868.8, math.inf, math.inf)
"""Centre, radius, and no turning point: the coefficients below are positive."""
IDEAL, BENT = np.zeros(0), np.array([0.004, 0.001])


def read_only(matrix: Floats) -> Floats:
    """Return a matrix as transforms hold it; Numba would compile a second variant for a writeable one."""
    matrix.flags.writeable = False
    return matrix


N = read_only(np.array([[40.0, 0.3, 700.0], [-0.2, 40.1, 510.0], [1e-5, -2e-5, 1.0]]))
BACK = read_only(np.asarray(np.linalg.inv(N), dtype=np.float64))
VIEWPOINT = (3.0, -4.0, 1 / 483.0)
COMPILES = settings(deadline=None, max_examples=40)
"""The first call waits for the compiler."""
positions = st.lists(st.tuples(st.floats(-15, 15), st.floats(-12, 12)), min_size=1, max_size=6).map(np.array)
pixels = st.lists(st.tuples(st.floats(0, 1391), st.floats(0, 1039)), min_size=1, max_size=6).map(np.array)


def _polynomial(raw: Floats, radial: Floats) -> Floats:
    offset = raw - SHAPE[:2]
    rho2 = (offset**2).sum(-1, keepdims=True) / SHAPE[2] ** 2
    factor = 1 + sum(a * rho2 ** (k + 1) for k, a in enumerate(radial))
    return np.asarray(np.array(SHAPE[:2]) + offset * factor)


def _project(points: Floats, heights: Floats, radial: Floats) -> Floats:
    out = np.empty_like(points)
    ground_to_image(points, heights, VIEWPOINT, N, radial, SHAPE, out)
    return out


@COMPILES
@given(pixels)
def test_undistortion_is_the_polynomial(raw: Floats) -> None:
    out = np.empty_like(raw)
    undistort_points(raw, BENT, SHAPE, out)
    np.testing.assert_allclose(out, _polynomial(raw, BENT), atol=1e-9)


@COMPILES
@given(pixels)
def test_distortion_inverts_the_polynomial(raw: Floats) -> None:
    out = np.empty_like(raw)
    distort_points(_polynomial(raw, BENT), BENT, SHAPE, out)
    np.testing.assert_allclose(out, raw, atol=1e-8)


def test_without_coefficients_both_change_nothing() -> None:
    raw, out = np.array([[1.0, 2.0], [900.0, 3.0]]), np.empty((2, 2))
    for convert in (undistort_points, distort_points):
        convert(raw, IDEAL, SHAPE, out)
        assert np.array_equal(out, raw)


@COMPILES
@given(positions, st.floats(-5, 60))
def test_a_raised_point_is_seen_where_its_ray_meets_the_plane(points: Floats, height: float) -> None:
    camera = np.array([*VIEWPOINT[:2], 483.0])
    raised = np.column_stack([points, np.full(len(points), height)])
    t = 483.0 / (483.0 - height)
    meets = (camera + t * (raised - camera))[:, :2]
    np.testing.assert_allclose(_project(points, np.array([height]), IDEAL), apply(N, meets), atol=1e-6)


@COMPILES
@given(positions, st.lists(st.floats(-5, 60), min_size=6, max_size=6))
def test_back_projection_inverts_projection_at_each_height(points: Floats, heights: list[float]) -> None:
    h = np.array(heights[: len(points)])
    raw, back = _project(points, h, BENT), np.empty_like(points)
    image_to_ground(raw, h, VIEWPOINT, BACK, BENT, SHAPE, back)
    np.testing.assert_allclose(back, points, atol=1e-8)


def test_one_height_applies_to_all_points() -> None:
    points = np.array([[1.0, 2.0], [-3.0, 4.0], [5.0, -6.0]])
    each: NDArray[np.float64] = np.full(3, 7.5)
    assert np.array_equal(_project(points, np.array([7.5]), BENT), _project(points, each, BENT))


@COMPILES
@given(pixels, st.tuples(st.floats(-5, 5), st.floats(-5, 5)))
def test_transfer_is_back_projection_shift_and_projection(raw: Floats, shift: tuple[float, float]) -> None:
    other = read_only(np.array([[39.0, 0, -500.0], [0, 39.0, 520.0], [0, 0, 1.0]]))
    found = transfer_points(raw, BACK, BENT, SHAPE, np.array(shift), other, IDEAL, SHAPE)
    expected = apply(other, apply(BACK, _polynomial(raw, BENT)) + shift)
    np.testing.assert_allclose(found, expected, atol=1e-7)


@pytest.mark.parametrize("beyond", [1.01, 1.5, 20.0])
def test_beyond_the_turning_point_points_move_on_outwards(beyond: float) -> None:
    a1 = -0.1
    edge = math.sqrt(1 / 0.3)
    furthest = edge * (1 + a1 * edge**2)
    shape = (0.0, 0.0, 100.0, edge, furthest)
    out = np.empty((1, 2))
    distort_points(np.array([[100 * furthest * beyond, 0.0]]), np.array([a1]), shape, out)
    assert out[0, 0] == pytest.approx(100 * (edge + furthest * (beyond - 1)))
