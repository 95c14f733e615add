"""Heights of parts: those of the twin's bodies, never those of the board beside them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.stitching.heights import _highest


def test_the_twins_parts_are_as_high_as_they_are(filmed: Any) -> None:
    q, true = filmed.stitch.quality, filmed.truth["heights"]
    found = q["heights_mm"]
    assert len(found) >= 4
    assert max(found.values()) > 2
    for ref, mm in found.items():
        assert mm == pytest.approx(true[ref], abs=0.03 + 0.01 * true[ref]), ref
        assert 0.005 < q["height_sigma_mm"][ref] < 0.2


def test_the_highest_group_that_agrees_is_the_body() -> None:
    sure = np.full(8, 0.05)
    heights = np.array([0.02, 0.0, 0.05, 0.03, 1.41, 1.38, 1.44, 3.0])
    found = _highest(heights, sure, 0.01)
    assert found is not None
    assert found.links == 3
    assert found.mm == pytest.approx(1.41, abs=0.005)
    assert 0.03 < found.sigma_mm < 0.06


def test_links_that_do_not_agree_tell_nothing() -> None:
    assert _highest(np.array([0.0, 0.8, 1.7, 2.9]), np.full(4, 0.05), 0.01) is None
    assert _highest(np.array([1.0, 1.0]), np.full(2, 0.05), 0.01) is None
    few = np.concatenate([np.zeros(17), np.full(3, 1.5)])
    found = _highest(few, np.full(20, 0.05), 0.01)
    assert found is not None
    assert found.mm == pytest.approx(0), "three of twenty are no body"


def test_without_a_working_distance_there_are_no_heights(filmed: Any) -> None:
    flat = filmed.calibration.model_copy(update={"working_distance_mm": None})
    assert filmed.stitched(calibration=flat).quality["heights_mm"] == {}
