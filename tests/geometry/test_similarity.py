"""The similarity as four numbers."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.geometry.similarity import apply_similarity, similarity_jacobian

number = st.floats(-10, 10)
points = st.lists(st.tuples(number, number), min_size=1, max_size=4)


@given(number, number, number, number, points)
def test_it_is_a_rotation_with_scale_and_a_shift(
    a: float, b: float, x: float, y: float, at: list[tuple[float, float]]
) -> None:
    cad = np.array(at)
    expected = (a + 1j * b) * (cad[:, 0] + 1j * cad[:, 1]) + (x + 1j * y)
    found = apply_similarity(np.array([a, b, x, y]), cad)
    np.testing.assert_allclose(found, np.stack([expected.real, expected.imag], -1), atol=1e-9)


@given(number, number, number, number, points)
def test_it_is_linear_in_its_numbers(a: float, b: float, x: float, y: float, at: list[tuple[float, float]]) -> None:
    cad, c = np.array(at), np.array([a, b, x, y])
    np.testing.assert_allclose(similarity_jacobian(cad) @ c, apply_similarity(c, cad), atol=1e-9)
