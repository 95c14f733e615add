"""Solved and inverted within the envelope, against numpy with the whole matrix."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from vaoi_station.stitching.adjustment.envelope import Envelope, add, factor, hold_first_row, inverse, of_rows, solve


@st.composite
def envelopes(draw: st.DrawFn) -> tuple[Envelope, NDArray[np.float64], NDArray[np.float64]]:
    """Rows that share something with some of those after them, and others; filled with whitened equations."""
    m, others = draw(st.integers(1, 7)), draw(st.sampled_from([0, 4, 5]))
    furthest = [draw(st.integers(row, m - 1)) for row in range(m)]
    envelope = Envelope.of(np.array(furthest), others)
    g = np.random.default_rng(draw(st.integers(0, 1000)))
    values, right = np.zeros(envelope.entries), np.zeros(envelope.size)
    n = envelope.size
    for row, last in enumerate(furthest):
        both = {3 * k + x for k in (row, last) for x in range(3)} | set(range(3 * m, n))
        columns = np.array(sorted(both))
        add(columns[None], g.normal(0, 1, (1, 20, len(columns))), g.normal(0, 1, (1, 20)), envelope.at, values, right)
    return envelope, values, right


@given(envelopes())
def test_solution_and_inverse_are_those_of_the_whole_matrix(
    made: tuple[Envelope, NDArray[np.float64], NDArray[np.float64]],
) -> None:
    envelope, values, right = made
    hold_first_row(envelope.first, envelope.at, values, right)
    whole = envelope.dense(values)
    assert (whole[:3] == np.eye(3, envelope.size)).all()
    assert not right[:3].any()
    factor(envelope.first, envelope.at, values)
    assert solve(envelope.first, envelope.at, values, right) == pytest.approx(np.linalg.solve(whole, right), abs=1e-9)
    inverted = np.linalg.inv(whole)
    found = inverse(envelope.first, envelope.at, envelope.rows, values)
    kept = envelope.dense(np.ones(envelope.entries)) > 0
    assert envelope.dense(found)[kept] == pytest.approx(inverted[kept], abs=1e-9)
    parts = of_rows(envelope, found)
    for j in range(envelope.rows):
        at = [3 * j, 3 * j + 1, 3 * j + 2, *range(3 * envelope.rows, envelope.size)]
        assert parts[j] == pytest.approx(inverted[np.ix_(at, at)], abs=1e-9)


@given(st.integers(1, 6), st.integers(0, 100))
def test_equations_add_up(rows: int, seed: int) -> None:
    g = np.random.default_rng(seed)
    envelope = Envelope.of(np.full(rows, rows - 1), 4)
    columns = np.array([g.permutation(envelope.size)[:5] for _ in range(3)])
    a, b = g.normal(0, 1, (3, 2, 5)), g.normal(0, 1, (3, 2))
    values, right = np.zeros(envelope.entries), np.zeros(envelope.size)
    add(columns, a, b, envelope.at, values, right)
    dense = np.zeros((6, envelope.size))
    for k in range(3):
        dense[2 * k : 2 * k + 2, columns[k]] = a[k]
    assert envelope.dense(values) == pytest.approx(dense.T @ dense)
    assert right == pytest.approx(-dense.T @ b.ravel())


def test_what_is_kept_grows_with_the_rows() -> None:
    few, many = (Envelope.of(np.minimum(np.arange(m) + 4, m - 1), 10).entries for m in (100, 200))
    assert many < 2.1 * few


def test_an_unknown_nobody_observed_is_unsure_and_harms_no_other() -> None:
    envelope = Envelope.of(np.array([0]), 2)
    values, right = np.zeros(envelope.entries), np.zeros(5)
    observed = np.array([[1.0, 1.0]])
    add(np.array([[3, 4]]), observed[None], np.array([[-2.0]]), envelope.at, values, right)
    hold_first_row(envelope.first, envelope.at, values, right)
    factor(envelope.first, envelope.at, values)
    assert solve(envelope.first, envelope.at, values, right)[3:].sum() == pytest.approx(2)
    assert inverse(envelope.first, envelope.at, 1, values)[-1] > 1e12
