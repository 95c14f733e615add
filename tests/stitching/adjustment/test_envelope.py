"""Solution and inverse within the envelope agree with numpy and the whole matrix."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.stitching.adjustment.envelope import (
    Envelope,
    NormalEquations,
    add_equations,
    factorise,
    hold_first_row,
    inverse,
    row_blocks,
    solve_backward,
    solve_forward,
    trailing_lines,
)


@st.composite
def envelopes(draw: st.DrawFn) -> tuple[Envelope, NormalEquations]:
    """Rows that share equations with some of the rows after them, and with the others; filled at random."""
    m, others = draw(st.integers(1, 7)), draw(st.sampled_from([0, 4, 5]))
    furthest = [draw(st.integers(row, m - 1)) for row in range(m)]
    envelope = Envelope.of(np.array(furthest), others)
    g = np.random.default_rng(draw(st.integers(0, 1000)))
    normal = envelope.zeros()
    for row, last in enumerate(furthest):
        both = {3 * k + x for k in (row, last) for x in range(3)} | set(range(3 * m, envelope.size))
        columns = np.array(sorted(both))
        add_equations(columns[None], g.normal(0, 1, (1, 20, len(columns))), g.normal(0, 1, (1, 20)), normal)
    return envelope, normal


@given(envelopes())
def test_solution_and_inverse_are_those_of_the_whole_matrix(made: tuple[Envelope, NormalEquations]) -> None:
    envelope, normal = made
    hold_first_row(normal)
    whole = envelope.dense(normal.values)
    assert (whole[:3] == np.eye(3, envelope.size)).all()
    assert not normal.right[:3].any()
    factorise(normal)
    assert solve_backward(normal, solve_forward(normal)) == pytest.approx(
        np.linalg.solve(whole, normal.right), abs=1e-9
    )
    inverted = np.linalg.inv(whole)
    found = inverse(normal, envelope.rows)
    kept = envelope.dense(np.ones(envelope.entries)) > 0
    assert envelope.dense(found)[kept] == pytest.approx(inverted[kept], abs=1e-9)
    parts = row_blocks(envelope, found)
    for j in range(envelope.rows):
        at = [3 * j, 3 * j + 1, 3 * j + 2, *range(3 * envelope.rows, envelope.size)]
        assert parts[j] == pytest.approx(inverted[np.ix_(at, at)], abs=1e-9)


@given(st.integers(1, 6), st.integers(0, 100))
def test_equations_add_up(rows: int, seed: int) -> None:
    g = np.random.default_rng(seed)
    envelope = Envelope.of(np.full(rows, rows - 1), 4)
    columns = np.array([g.permutation(envelope.size)[:5] for _ in range(3)])
    a, b = g.normal(0, 1, (3, 2, 5)), g.normal(0, 1, (3, 2))
    normal = envelope.zeros()
    add_equations(columns, a, b, normal)
    dense = np.zeros((6, envelope.size))
    for k in range(3):
        dense[2 * k : 2 * k + 2, columns[k]] = a[k]
    assert envelope.dense(normal.values) == pytest.approx(dense.T @ dense)
    assert normal.right == pytest.approx(-dense.T @ b.ravel())


def test_memory_grows_linearly_with_the_rows() -> None:
    few, many = (Envelope.of(np.minimum(np.arange(m) + 4, m - 1), 10).entries for m in (100, 200))
    assert many < 2.1 * few


def test_an_unobserved_unknown_is_uncertain_and_disturbs_no_other() -> None:
    envelope = Envelope.of(np.array([0]), 2)
    normal = envelope.zeros()
    add_equations(np.array([[3, 4]]), np.array([[[1.0, 1.0]]]), np.array([[-2.0]]), normal)
    hold_first_row(normal)
    factorise(normal)
    assert solve_backward(normal, solve_forward(normal))[3:].sum() == pytest.approx(2)
    assert inverse(normal, 1)[-1] > 1e12


def test_rows_that_share_no_equation_store_no_entry() -> None:
    alone, coupled = (Envelope.of(np.array(furthest), 0) for furthest in ([0, 1, 2], [1, 2, 2]))
    assert alone.entries == 3 * 6
    assert coupled.entries == 3 * 6 + 2 * 9
    assert not alone.dense(np.ones(alone.entries))[3:6, :3].any()


@given(envelopes())
def test_the_trailing_block_of_the_factor_is_that_of_the_reduced_matrix(made: tuple[Envelope, NormalEquations]) -> None:
    """Its square is the Schur complement: the normal matrix of the last unknowns, all others eliminated."""
    envelope, normal = made
    count = envelope.size - 3 * envelope.rows
    whole = envelope.dense(normal.values)
    factorise(normal)
    lower = np.tril(normal.values[trailing_lines(envelope, count)])
    rows = envelope.size - count
    own, cross = whole[rows:, rows:], whole[:rows, rows:]
    expected = own - cross.T @ np.linalg.solve(whole[:rows, :rows], cross)
    assert lower @ lower.T == pytest.approx(expected, abs=1e-8)
