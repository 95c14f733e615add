"""Blocks cover the box they are asked for, and linear functions survive the interpolation."""

from __future__ import annotations

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.simulation.imaging.lattice import BLOCK_PX, OVERSAMPLING, Lattice

WIDTH, HEIGHT = 100, 60
X, Y = st.floats(-40, WIDTH + 40), st.floats(-40, HEIGHT + 40)


def whole() -> Lattice:
    lattice = Lattice.over(np.zeros(2), np.array([WIDTH - 1.0, HEIGHT - 1.0]), WIDTH, HEIGHT)
    assert lattice is not None
    return lattice


def sample_places(lattice: Lattice) -> tuple[np.ndarray, np.ndarray]:
    """Raw pixels of the samples that the lattice covers, along x and along y."""
    rows, columns = lattice.window
    x = (np.arange(columns.start, columns.stop) + 0.5) / OVERSAMPLING - 0.5
    y = (np.arange(rows.start, rows.stop) + 0.5) / OVERSAMPLING - 0.5
    return x, y


@given(X, Y, X, Y)
def test_the_blocks_cover_the_part_of_the_box_inside_the_frame(x0: float, y0: float, x1: float, y1: float) -> None:
    low, high = np.array([min(x0, x1), min(y0, y1)]), np.array([max(x0, x1), max(y0, y1)])
    lattice = Lattice.over(low, high, WIDTH, HEIGHT)
    inside_low, inside_high = np.maximum(low, -0.5), np.minimum(high, [WIDTH - 0.5, HEIGHT - 0.5])
    if lattice is None:
        assert (inside_high - inside_low <= 0).any()
        return
    x, y = sample_places(lattice)
    half = 0.5 / OVERSAMPLING
    assert x[0] - half <= inside_low[0]
    assert y[0] - half <= inside_low[1]
    assert x[-1] + half >= inside_high[0]
    assert y[-1] + half >= inside_high[1]


@given(st.floats(-2, 2), st.floats(-2, 2), st.floats(-50, 50))
def test_linear_functions_are_interpolated_exactly(a: float, b: float, c: float) -> None:
    lattice = whole()
    values = lattice.nodes_px @ [a, b] + c
    x, y = sample_places(lattice)
    found = lattice.spread(values, (len(y), len(x)))
    assert np.abs(found - (a * x[None] + b * y[:, None] + c)).max() < 1e-3


def test_a_quadratic_function_errs_by_less_than_the_stated_bound() -> None:
    """The bound of linear interpolation: an eighth of the second derivative times the step squared, per axis."""
    lattice = whole()
    k = 1e-3
    values = k * (lattice.nodes_px**2).sum(1)
    x, y = sample_places(lattice)
    error = lattice.spread(values, (len(y), len(x))) - k * (x[None] ** 2 + y[:, None] ** 2)
    assert 0 < np.abs(error).max() <= 2 * (2 * k) * BLOCK_PX**2 / 8 + 1e-4


def test_the_result_is_cut_to_the_shape_asked_for() -> None:
    lattice = whole()
    assert lattice.spread(np.zeros(len(lattice.nodes_px)), (7, 5)).shape == (7, 5)


@pytest.mark.parametrize("corner", [(-50.0, 10.0), (10.0, -50.0), (WIDTH + 9.0, 10.0), (10.0, HEIGHT + 9.0)])
def test_a_box_off_the_frame_has_no_blocks(corner: tuple[float, float]) -> None:
    low = np.array(corner)
    assert Lattice.over(low, low + 5.0, WIDTH, HEIGHT) is None


def test_nodes_are_the_centres_of_the_blocks_and_their_neighbours() -> None:
    lattice = Lattice(1, 2, 3, 3)
    assert lattice.nodes_px.tolist() == [
        [x, y] for y in (11.5, 19.5, 27.5) for x in (3.5, 11.5, 19.5, 27.5)
    ]  # fmt: skip
    assert lattice.window == (slice(32, 48), slice(16, 48))
