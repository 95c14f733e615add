from __future__ import annotations

import math

import numpy as np
import pytest
from hypothesis import assume, given
from hypothesis import strategies as st

from vaoi_station.geometry import Similarity, System
from vaoi_station.geometry.robust import Failure, fit_similarity, median_sigma

coordinates = st.floats(-300, 300)
clouds = st.lists(st.tuples(coordinates, coordinates), min_size=2, max_size=8).map(np.array)


def fit(q: object, p: object, *, mirrored: bool = False) -> Similarity | Failure:
    return fit_similarity(np.array(q), np.array(p), System.TESTER, System.CAD, mirrored=mirrored)


@given(clouds, st.floats(0.02, 30), st.floats(-math.pi, math.pi), st.tuples(coordinates, coordinates), st.booleans())
def test_exact_points_give_the_exact_similarity(
    p: np.ndarray, scale: float, angle: float, shift: tuple[float, float], mirrored: bool
) -> None:
    assume(np.ptp(p, axis=0).max() > 1)
    truth = Similarity.of(scale, angle, shift, System.TESTER, System.CAD, mirrored=mirrored)
    found = fit(truth(p), p, mirrored=mirrored)
    assert isinstance(found, Similarity)
    assert (found.target, found.source) == (System.TESTER, System.CAD)
    assert found.mirrors is mirrored
    np.testing.assert_allclose(found(p), truth(p), atol=1e-8)


@pytest.mark.parametrize(
    ("target", "source", "reason"),
    [
        ([[1, 2]], [[3, 4]], "1 point"),
        ([[1, 2], [3, 4]], [[5, 6], [5, 6]], "all points coincide"),
        ([[0.3, 2], [3, 4], [5, 5]], [[0.1, 0.7]] * 3, "all points coincide"),
        ([[0.1, 0.7]] * 3, [[0.3, 2], [3, 4], [5, 5]], "target points coincide"),
        ([[0, 0], [0, 0]], [[0, 0], [1, 0]], "target points coincide"),
        ([[1, 0], [-1, 0], [0, 1], [0, -1]], [[1, 0], [-1, 0], [0, -1], [0, 1]], "nothing in common"),
    ],
)
def test_degenerate_points_fail_with_a_reason(target: object, source: object, reason: str) -> None:
    found = fit(target, source)
    assert isinstance(found, Failure)
    assert reason in found.reason


def test_median_sigma_is_that_of_normal_data_and_unmoved_by_outliers() -> None:
    r = np.random.default_rng(0).normal(0, 0.2, 20000)
    assert median_sigma(r) == pytest.approx(0.2, rel=0.03)
    assert median_sigma(np.append(r, [1e6] * 100)) == pytest.approx(0.2, rel=0.05)
    assert math.isnan(median_sigma([]))
