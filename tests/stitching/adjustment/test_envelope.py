"""Solution and inverse within the envelope agree with numpy and the whole matrix."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.envelope import (
    NormalEquations,
    add_equations,
    factorise,
    hold_first_row,
    inverse,
    solve_backward,
    solve_forward,
)


def dense(normal: NormalEquations, values: Floats | None = None) -> Floats:
    """Return the full symmetric matrix whose lower triangle has these stored values."""
    out = np.zeros((len(normal.first),) * 2)
    for i, (first, at) in enumerate(zip(normal.first.tolist(), normal.at.tolist(), strict=True)):
        own = (normal.values if values is None else values)[at + first : at + i + 1]
        out[i, first : i + 1] = out[first : i + 1, i] = own
    return out


@st.composite
def envelopes(draw: st.DrawFn) -> NormalEquations:
    """Rows that share equations with some of the rows after them, and with the others; filled at random."""
    m, others = draw(st.integers(1, 7)), draw(st.sampled_from([0, 4, 5]))
    furthest = [draw(st.integers(row, m - 1)) for row in range(m)]
    normal = NormalEquations.of(np.array(furthest), others)
    g = np.random.default_rng(draw(st.integers(0, 1000)))
    for row, last in enumerate(furthest):
        both = {3 * k + x for k in (row, last) for x in range(3)} | set(range(3 * m, 3 * m + others))
        columns = np.array(sorted(both))
        add_equations(columns[None], g.normal(0, 1, (1, 20, len(columns))), g.normal(0, 1, (1, 20)), normal)
    return normal


@given(envelopes())
def test_solution_and_inverse_are_those_of_the_whole_matrix(normal: NormalEquations) -> None:
    hold_first_row(normal)
    whole = dense(normal)
    assert (whole[:3] == np.eye(3, len(whole))).all()
    assert not normal.right[:3].any()
    factorise(normal)
    assert solve_backward(normal, solve_forward(normal)) == pytest.approx(
        np.linalg.solve(whole, normal.right), abs=1e-9
    )
    inverted = np.linalg.inv(whole)
    found = inverse(normal)
    kept = dense(normal, np.ones_like(found)) > 0
    assert dense(normal, found)[kept] == pytest.approx(inverted[kept], abs=1e-9)
    parts = normal.row_blocks(found)
    for j in range(normal.rows):
        at = [3 * j, 3 * j + 1, 3 * j + 2, *range(3 * normal.rows, len(whole))]
        assert parts[j] == pytest.approx(inverted[np.ix_(at, at)], abs=1e-9)


@given(st.integers(1, 6), st.integers(0, 100))
def test_equations_add_up(rows: int, seed: int) -> None:
    g = np.random.default_rng(seed)
    normal = NormalEquations.of(np.full(rows, rows - 1), 4)
    columns = np.array([g.permutation(len(normal.first))[:5] for _ in range(3)])
    a, b = g.normal(0, 1, (3, 2, 5)), g.normal(0, 1, (3, 2))
    add_equations(columns, a, b, normal)
    whole = np.zeros((6, len(normal.first)))
    for k in range(3):
        whole[2 * k : 2 * k + 2, columns[k]] = a[k]
    assert dense(normal) == pytest.approx(whole.T @ whole)
    assert normal.right == pytest.approx(-whole.T @ b.ravel())


@given(envelopes())
def test_the_trailing_block_of_the_factor_is_that_of_the_reduced_matrix(normal: NormalEquations) -> None:
    """Its square is the Schur complement: the normal matrix of the last unknowns, all others eliminated."""
    rows, whole = 3 * normal.rows, dense(normal)
    count = len(whole) - rows
    factorise(normal)
    lower = np.tril(normal.values[normal.trailing(count)])
    own, cross = whole[rows:, rows:], whole[:rows, rows:]
    expected = own - cross.T @ np.linalg.solve(whole[:rows, :rows], cross)
    assert lower @ lower.T == pytest.approx(expected, abs=1e-8)
