from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vaoi_station.marks.small_cholesky import position_variance, solve_cholesky

COMPILES = settings(deadline=None)
"""The first call waits for the compiler."""


@COMPILES
@given(st.integers(0, 2**31), st.integers(1, 4))
def test_normal_equations_are_solved_as_numpy_solves_them(seed: int, unknowns: int) -> None:
    g = np.random.default_rng(seed)
    design, right = g.normal(size=(12, unknowns)), g.normal(size=12)
    square = design.T @ design
    table = np.zeros((4, 5))
    table[:unknowns, :unknowns], table[:unknowns, 4] = np.triu(square), design.T @ right
    assert solve_cholesky(table, unknowns)
    assert np.allclose(table[:unknowns, 4], np.linalg.solve(square, design.T @ right), rtol=1e-6, atol=1e-9)
    if unknowns == 4:
        assert position_variance(table) == pytest.approx(np.diag(np.linalg.inv(square))[:2].mean(), rel=1e-6)


def test_singular_equations_are_reported() -> None:
    table = np.zeros((4, 5))
    table[:2, :2] = 1.0
    assert not solve_cholesky(table, 2)
    assert not solve_cholesky(np.zeros((4, 5)), 1)


@pytest.mark.parametrize("unknowns", [1, 2, 3])
def test_equations_beyond_the_unknowns_are_ignored(unknowns: int) -> None:
    table = np.full((4, 5), np.nan)
    table[:unknowns, :unknowns] = 2 * np.eye(unknowns)
    table[:unknowns, 4] = np.arange(unknowns) + 1
    assert solve_cholesky(table, unknowns)
    assert table[:unknowns, 4] == pytest.approx([0.5 * (k + 1) for k in range(unknowns)])


def test_not_a_number_is_singular() -> None:
    table = np.zeros((4, 5))
    table[0, 0], table[1, 1] = 1.0, np.nan
    assert not solve_cholesky(table, 2)
