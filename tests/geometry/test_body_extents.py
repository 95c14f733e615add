from __future__ import annotations

import pytest

from vaoi_station.geometry.body_extents import EXTENTS


def test_the_prior_probabilities_are_those_of_one_axis() -> None:
    assert EXTENTS[:, 2].sum() == pytest.approx(1.0)
    assert (EXTENTS > 0).all()


def test_extents_are_symmetrical_and_at_most_the_footprint() -> None:
    swapped = {(b, a): p for a, b, p in EXTENTS.tolist()}
    assert {(a, b): p for a, b, p in EXTENTS.tolist()} == swapped
    assert EXTENTS[:, :2].max() == 1.0
    assert EXTENTS[:, 2].argmax() == len(EXTENTS) - 1, "a block that fills its footprint is the most frequent"
