"""The noise floor explains the median of the residuals."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.stitching.adjustment.problem import Problem, to_observations
from vaoi_station.stitching.adjustment.solver import NoiseFloors, noise_floor
from vaoi_station.stitching.matching.evidence import Links, Task


@given(st.integers(0, 10_000), st.integers(1, 40), st.sampled_from([1e-4, 0.02, 3.0]))
def test_half_of_the_used_measurements_are_within_the_median(seed: int, count: int, real: float) -> None:
    """Compare with the same bisections over all measurements."""
    g = np.random.default_rng(seed)
    half = g.normal(0, 0.01, (count, 2, 2))
    residual, noise, px_per_mm = g.normal(0, real, (count, 2)), half @ half.swapaxes(1, 2), g.uniform(5, 50, count)
    use = np.flatnonzero(g.random(count) < 0.7)
    low, high = 0.003, 5.0
    for _ in range(12):
        middle = np.sqrt(low * high)
        wider = noise + ((middle / px_per_mm) ** 2)[:, None, None] * np.eye(2)
        chi2 = np.einsum("ki,kij,kj->k", residual, np.linalg.inv(wider), residual)[use]
        low, high = (middle, high) if 2 * (chi2 > 2 * np.log(2)).sum() > len(use) else (low, middle)
    assert noise_floor(residual, noise, px_per_mm, use, 0.003, 5.0) == pytest.approx(np.sqrt(low * high), rel=1e-9)


def test_the_noise_floor_is_in_the_requested_unit_and_tolerates_outliers() -> None:
    g = np.random.default_rng(1)
    residual_mm, none = g.normal(0, 0.05 / 20, (4000, 2)), np.zeros((4000, 2, 2))
    residual_mm[:1000] += 3
    all_of_them = np.arange(4000)
    assert noise_floor(residual_mm, none, np.full(4000, 20.0), all_of_them[1000:], 0.003, 5.0) == pytest.approx(
        0.05, rel=0.04
    )
    assert 0.05 < noise_floor(residual_mm, none, np.full(4000, 20.0), all_of_them, 0.003, 5.0) < 0.08, (
        "a quarter is wild"
    )


def test_few_false_links_on_the_bare_board_do_not_set_the_noise_of_all(workshop: Any) -> None:
    """At the edges of a board on a bed with texture, most of the links that seem to be on the bare board are false."""
    g, count, bare = np.random.default_rng(2), 300, 30
    px = g.uniform(50, 350, (count, 2))
    links = to_observations(
        [Links(Task("rows", (0, 0), (0, 1)), px, px, np.tile(np.eye(2) / 0.01**2, (count, 1, 1)), np.ones(count))],
        (workshop.camera(),),
    )
    component = np.where(np.arange(count) < bare, -1, 0)
    problem = Problem(np.array([0.0, 0.1]), np.array([0.0, 50.0]), links, component)
    residual = g.normal(0, 0.01 / 10, (count, 2))
    residual[:20] = g.normal(0, 2.0 / 10, (20, 2))
    floors = NoiseFloors(problem, np.zeros(count, np.int_), 1, np.zeros(count, np.bool_))
    floors.update(residual, displaceable=False)
    assert floors.px[0] < 0.05
