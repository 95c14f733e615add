"""Heights of components: those of the twin's bodies, never those of the board beside them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.stitching.quality.heights import (
    FootprintArrays,
    LinkArrays,
    highest_agreeing_groups,
    per_link_heights,
)


def test_heights_of_the_twins_components_match_the_truth(filmed: Any) -> None:
    q, true = filmed.stitch.quality, filmed.truth["heights"]
    found = q["heights_mm"]
    assert len(found) >= 4
    assert max(found.values()) > 2
    for ref, mm in found.items():
        assert mm == pytest.approx(true[ref], abs=0.03 + 0.01 * true[ref]), ref
        assert 0.005 < q["height_sigma_mm"][ref] < 0.2


def test_link_height_explains_the_residual() -> None:
    """Against numpy. Of five links one lies on a corner, and one on a component too small for a patch."""
    g = np.random.default_rng(3)
    center, size = np.array([[2.0, 1.0], [9.0, 4.0]]), np.array([[3.0, 2.0], [0.4, 0.4]])
    angle, floor_px = np.radians([30.0, 0.0]), 0.02
    turn = np.array([[np.cos(angle[0]), -np.sin(angle[0])], [np.sin(angle[0]), np.cos(angle[0])]])
    inside = np.array([[0.3, -0.2], [-1.1, 0.6], [1.4, 0.9], [0.0, 0.0]]) @ turn.T + center[0]
    place = np.vstack([inside, center[1]])
    near, component = np.array([5, 3, 1, 0, 4]), np.array([0, 0, -1, 0, 1, 0])
    misfit, lean, half = g.normal(0, 0.02, (5, 2)), g.normal(0, 0.1, (5, 2)), g.normal(0, 1e-3, (6, 2, 2))
    ground, noise, resolution = g.normal(0, 0.1, 6), half @ half.swapaxes(1, 2), g.uniform(30, 40, 6)
    links = LinkArrays(near, place, misfit, lean, ground, noise, resolution, component)
    footprints = FootprintArrays(center, size, angle, 1.0)
    height, sigma, sole, aside = per_link_heights(links, footprints, np.eye(3), floor_px)
    assert np.isinf(sigma).tolist() == [False, False, True, False, True]
    for i in (0, 1, 3):
        n = near[i]
        weight = np.linalg.inv(noise[n] + (floor_px / resolution[n]) ** 2 * np.eye(2))
        residual, information = misfit[i] + lean[i] * ground[n], lean[i] @ weight @ lean[i]
        assert height[i] == pytest.approx(-(lean[i] @ weight @ residual) / information)
        assert sigma[i] == pytest.approx(information**-0.5)
        left = residual + lean[i] * height[i]
        assert aside[i] == pytest.approx(np.sqrt(left @ weight @ left), abs=1e-9)
        assert sole[i] == pytest.approx(0.015 / resolution[n] / np.hypot(*lean[i]))


Part = list[float]


def heights_of(*parts: Part) -> list[tuple[float, float, int]]:
    """Height, sigma and number of links of components whose links give these heights."""
    heights = np.array([mm for part in parts for mm in part])
    ends = np.cumsum([len(part) for part in parts])
    found = highest_agreeing_groups(ends, heights, np.full(len(heights), 0.05), np.full(len(heights), 0.01))
    return list(zip(*(values.tolist() for values in found), strict=True))


def test_the_highest_agreeing_group_is_the_body() -> None:
    [(mm, sigma_mm, links)] = heights_of([0.02, 0.0, 0.05, 0.03, 1.41, 1.38, 1.44, 3.0])
    assert links == 3
    assert mm == pytest.approx(1.41, abs=0.005)
    assert 0.03 < sigma_mm < 0.06


def test_links_that_do_not_agree_give_no_height() -> None:
    assert heights_of([0.0, 0.8, 1.7, 2.9])[0][2] == 0
    assert heights_of([1.0, 1.0])[0][2] == 0
    assert heights_of([])[0][2] == 0
    [(mm, _, links)] = heights_of([0.0] * 17 + [1.5] * 3)
    assert links == 17
    assert mm == pytest.approx(0), "three of twenty are no body"


@given(st.lists(st.lists(st.sampled_from([0.0, 0.04, 0.3, 0.9, 0.93, 1.6]), max_size=9), min_size=1, max_size=5))
def test_every_component_gets_the_highest_group_of_its_own_links(parts: list[Part]) -> None:
    for part, (mm, sigma_mm, links) in zip(parts, heights_of(*parts), strict=True):
        h, variance = np.array(part), 0.05**2 + 0.03**2
        agree = np.abs(h[None] - h[:, None]) <= 2.5 * np.sqrt(variance)
        able = agree.sum(1) >= max(3, 0.25 * len(h))
        assert (links > 0) == able.any()
        if links:
            means = np.where(able, (agree @ h) / np.maximum(agree.sum(1), 1), -np.inf)
            assert mm == pytest.approx(means.max())
            assert links in agree.sum(1)[means > means.max() - 1e-9]
            assert sigma_mm == pytest.approx(np.sqrt(variance / links + 0.01**2 + (0.01 * mm) ** 2))


def test_without_a_working_distance_there_are_no_heights(filmed: Any) -> None:
    flat = filmed.calibration.model_copy(update={"working_distance_mm": None})
    assert filmed.stitched(calibration=flat).quality["heights_mm"] == {}
