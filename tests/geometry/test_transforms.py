from __future__ import annotations

import math
import pickle

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.errors import InternalError
from vaoi_station.geometry import Euclidean, Projective, Similarity, System

angles = st.floats(-math.pi, math.pi)
shifts = st.tuples(st.floats(-500, 500), st.floats(-500, 500))
scales = st.floats(0.02, 50)
points = st.lists(shifts, min_size=1, max_size=6).map(np.array)
similarities = st.builds(
    lambda k, a, t, m: Similarity.of(k, a, t, System.TESTER, System.CAD, mirrored=m),
    scales,
    angles,
    shifts,
    st.booleans(),
)
motions = st.builds(lambda a, t: Euclidean.motion(a, t, System.ROW, System.TESTER), angles, shifts)
tilts = st.floats(-1e-4, 1e-4)
homographies = st.builds(
    lambda k, a, t, g, h: Projective(
        np.array([[1, 0, 0], [0, 1, 0], [g, h, 1]])
        @ Similarity.of(k, a, t, System.IMAGE, System.ROW).matrix, System.IMAGE, System.ROW
    ),
    st.floats(5, 60), angles, shifts, tilts, tilts,
)  # fmt: skip


@given(similarities, points)
def test_the_inverse_of_a_similarity_maps_back(tester_from_cad: Similarity, p: np.ndarray) -> None:
    back = tester_from_cad.inverse()
    assert (back.target, back.source) == (System.CAD, System.TESTER)
    assert type(back) is Similarity
    np.testing.assert_allclose(back(tester_from_cad(p)), p, atol=1e-7)


@given(homographies, motions, similarities, points)
def test_a_product_applies_its_factors_from_right_to_left(
    n: Projective, d: Euclidean, c: Similarity, p: np.ndarray
) -> None:
    image_from_cad = n @ d @ c
    assert (image_from_cad.target, image_from_cad.source) == (System.IMAGE, System.CAD)
    np.testing.assert_allclose(image_from_cad(p), n(d(c(p))), rtol=1e-6, atol=1e-6)
    np.testing.assert_allclose((n @ (d @ c)).matrix, ((n @ d) @ c).matrix, rtol=1e-9, atol=1e-6)


def test_a_product_with_different_inner_systems_is_refused() -> None:
    d = Euclidean.identity(System.ROW, System.TESTER)
    with pytest.raises(InternalError, match="row_from_tester @ image_from_row: no match"):
        d @ Projective(np.eye(3), System.IMAGE, System.ROW)


@given(motions, points)
def test_a_motion_keeps_distances(d: Euclidean, p: np.ndarray) -> None:
    q = d(p)
    np.testing.assert_allclose(np.hypot(*(q - q[0]).T), np.hypot(*(p - p[0]).T), atol=1e-9)
    assert not d.mirrors


@given(scales, angles, shifts, st.booleans())
def test_a_similarity_returns_its_parameters(k: float, a: float, t: tuple[float, float], mirrored: bool) -> None:
    made = Similarity.of(k, a, t, System.TESTER, System.CAD, mirrored=mirrored)
    assert made.scale == pytest.approx(k)
    assert math.cos(made.angle_rad - a) == pytest.approx(1)
    assert made.mirrors is mirrored
    np.testing.assert_allclose(made((0, 0)), t)
    assert made.scale_at((3, 4)) == pytest.approx(k)


@pytest.mark.parametrize("bad", [np.eye(2), np.full((3, 3), np.nan), np.diag([1, 1, np.inf])])
def test_a_matrix_that_is_not_finite_is_refused(bad: np.ndarray) -> None:
    with pytest.raises(InternalError, match="image_from_row is not a finite 3×3 matrix"):
        Projective(bad, System.IMAGE, System.ROW)


@pytest.mark.parametrize(
    "bad",
    [
        [[1, 0, 0], [0, 2, 0], [0, 0, 1]],
        [[1, 0.1, 0], [0, 1, 0], [0, 0, 1]],
        [[1, 0, 0], [0, 1, 0], [1e-4, 0, 1]],
        [[1, 0, 0], [0, 1, 0], [0, 0, 2]],
        [[0, 0, 0], [0, 0, 0], [0, 0, 1]],
    ],
)
def test_stretch_shear_and_tilt_are_no_similarity(bad: list[list[float]]) -> None:
    with pytest.raises(InternalError, match="tester_from_cad is no similarity"):
        Similarity(np.array(bad), System.TESTER, System.CAD)


def test_a_singular_matrix_has_no_inverse() -> None:
    flat = Projective(np.array([[1.0, 1, 0], [1, 1, 0], [0, 0, 1]]), System.IMAGE, System.ROW)
    with pytest.raises(InternalError, match="singular"):
        flat.inverse()


@given(st.one_of(similarities, motions, homographies))
def test_a_pickled_transform_is_equal_and_read_only(transform: Projective) -> None:
    there = pickle.loads(pickle.dumps(transform))
    assert type(there) is type(transform)
    assert (there.target, there.source) == (transform.target, transform.source)
    assert np.array_equal(there.matrix, transform.matrix)
    assert not there.matrix.flags.writeable
