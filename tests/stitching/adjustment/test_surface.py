"""The basis of the surface, and its conversion to a result."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.geometry import apply
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.problem import SIGMA_MM, basis, basis_at_board, prior_sigma_mm, to_surface

BOARD = BoardType(name="b", unit="inch", outline=((0.0, 3.0), (2.0, 0.5)))


@given(
    st.lists(st.floats(-1, 1), min_size=6, max_size=6),
    st.lists(st.tuples(st.floats(-1, 4), st.floats(-1, 5)), min_size=1, max_size=5),
)
def test_results_have_the_estimated_surface(c: list[float], points: list[tuple[float, float]]) -> None:
    at = np.array(points)
    surface = to_surface(BOARD, np.array(c))
    np.testing.assert_allclose(surface.height_mm(at), basis(BOARD, at) @ c, atol=5e-5)


def test_the_centre_has_the_lift_and_the_corners_have_all_coefficients() -> None:
    values = basis(BOARD, np.array([[1.0, 1.75], [2.0, 3.0], [0.0, 3.0]]))
    assert values.tolist() == [[1, 0, 0, 0, 0, 0], [1, 1, 1, 1, 1, 1], [1, -1, 1, 1, -1, 1]]
    assert len(SIGMA_MM) == 6


def test_points_of_the_board_have_the_values_of_their_cad_points() -> None:
    c = np.array([[25.4, 0, 7], [0, -25.4, 9], [0, 0, 1.0]])
    at = np.array([[0.3, 0.7], [1.9, 2.2]])
    np.testing.assert_allclose(basis_at_board(BOARD, c, apply(c, at)), basis(BOARD, at), atol=1e-12)


def test_the_prior_of_the_surface_has_heavy_tails() -> None:
    assert prior_sigma_mm(np.zeros(6), SIGMA_MM).tolist() == SIGMA_MM.tolist()
    likely = prior_sigma_mm(SIGMA_MM / 2, SIGMA_MM)
    assert (likely < 1.1 * SIGMA_MM).all()
    tilted = prior_sigma_mm(np.array([0.2, 0.4, -0.6, 0, 0, 0]), SIGMA_MM)
    # A tilt along one axis widens the prior along the other one, and leaves lift and bow.
    assert (tilted[1:3] > 3 * SIGMA_MM[1:3]).all()
    assert tilted[[0, 3, 4, 5]].tolist() == pytest.approx(SIGMA_MM[[0, 3, 4, 5]], rel=0.01)


def test_a_lift_of_many_millimetres_stays_unlikely() -> None:
    """Otherwise it would explain a turned camera with a single seam (`tests/cases/test_watching.py`)."""
    lifted = prior_sigma_mm(np.array([11.0, 0, 0, 0, 0, 0]), SIGMA_MM)
    assert lifted.tolist() == SIGMA_MM.tolist()


@given(st.floats(0, 50))
def test_a_larger_tilt_is_less_likely(tilt_mm: float) -> None:
    """The gradient of the prior points to 0 everywhere, however weak it is."""
    at = np.array([0, tilt_mm, 0, 0, 0, 0])
    assert (at / prior_sigma_mm(at, SIGMA_MM) ** 2)[1] >= 0
    assert tilt_mm / prior_sigma_mm(at, SIGMA_MM)[1] < 3
