"""Heights of components from the links on their bodies, against known heights."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.simulation.scenario import AbsentPart
from vaoi_station.stitching.quality.heights import BodyLinks, body_heights
from vaoi_station.stitching.work import StitchSetup, stitch_frames


def heights_of_twin(seed: int, absent: tuple[str, ...] = ()) -> dict[str, tuple[float, float, float]]:
    """Film and stitch a board of the twin; return its heights, their σ, and the true heights."""
    scenario = read_scenario(scenario_path("small"))
    board = scenario.board.model_copy(update={"seed": seed, "length_mm": 30.0})
    faults = scenario.faults.model_copy(update={"absent_parts": tuple(AbsentPart(ref=ref) for ref in absent)})
    twin = Twin(scenario.model_copy(update={"board": board, "faults": faults}))
    passage = twin.passage(0)
    head, frames = passage.head(), passage.render_all()
    cameras = twin.calibration.cameras(head.cameras)
    setup = StitchSetup(cameras, head.conveyor_mm_s, head.trigger_period_s, twin.board_type)
    stitch = stitch_frames(setup, head, lambda i, j: frames.get((i, j)))
    true, sigma = passage.truth()["heights"], stitch.quality["height_sigma_mm"]
    return {ref: (mm, sigma[ref], true[ref]) for ref, mm in stitch.quality["heights_mm"].items()}


def test_heights_of_the_twins_components_match_the_truth(filmed: Any) -> None:
    q, true = filmed.stitch.quality, filmed.truth["heights"]
    found = q["heights_mm"]
    assert len(found) >= 3
    assert max(found.values()) > 2
    for ref, mm in found.items():
        assert mm == pytest.approx(true[ref], abs=0.03 + 0.01 * true[ref]), ref
        assert 0.003 < q["height_sigma_mm"][ref] < 0.2


def test_errors_of_heights_are_those_that_sigma_states() -> None:
    """Before links were sorted by the extent of the body, every fourth height was wrong by more than 3 σ."""
    found = [values for seed in (31, 32, 33) for values in heights_of_twin(seed).values()]
    z = np.array([(mm - true) / sigma for mm, sigma, true in found])
    assert len(z) >= 5
    assert np.sqrt((z**2).mean()) < 1.4
    assert np.abs(z).max() < 3.5


def test_a_missing_part_has_no_height_of_a_body() -> None:
    """The truth of an absent part is 0."""
    for mm, sigma, true in heights_of_twin(31, absent=("U1",)).values():
        assert abs(mm - true) < 3.5 * sigma


Link = tuple[float, float, float]
"""Height and place (x, y) of a link, mm."""

_HALF_MM = (3.3, 3.25)
"""Half the footprint of a TSSOP-20, whose body reaches to 2.2 mm on both sides."""
LEADS: list[Link] = [(0.0, x, y) for x in (-3.0, 2.9) for y in (-2.0, -0.6, 0.6, 2.0)]


def heights_of(*parts: list[Link], sigma_mm: float = 0.02, reach_mm: float = 0.3) -> list[tuple[float, float, int]]:
    """Height, sigma and number of links of components with these links, three to a pair of frames."""
    ends = np.cumsum([len(part) for part in parts])
    rows = np.array([link for part in parts for link in part]).reshape(-1, 3)
    n = len(rows)
    pair = np.concatenate([np.arange(len(part)) // 3 for part in parts])
    links = BodyLinks(
        rows[:, 0].copy(),
        np.full(n, sigma_mm),
        np.full(n, 0.005),
        pair,
        np.ascontiguousarray(rows[:, 1:]),
        np.full(n, reach_mm),
    )
    found = body_heights(ends, links, np.tile(_HALF_MM, (len(parts), 1)))
    return list(zip(*(values.tolist() for values in found), strict=True))


def test_few_links_on_the_body_win_over_many_on_the_leads() -> None:
    body = [(1.11, -1.1, -1.3), (1.09, 0.1, 1.0), (1.10, 0.9, 0.2)]
    [(mm, sigma_mm, links)] = heights_of(LEADS * 2 + body)
    assert links == 3
    assert mm == pytest.approx(1.1, abs=0.01)
    assert 0.005 < sigma_mm < 0.04


def test_body_may_fill_its_footprint_or_lie_off_its_centre() -> None:
    """A block has links at its rim. A connector ends before one edge of its footprint."""
    rim = [(1.5, x, y) for x in (-2.9, 0.0, 2.9) for y in (-2.9, 0.0, 2.9)]
    shifted = [(1.5, x, y) for x in (-2.9, 0.0, 2.9) for y in (-2.0, 0.0, 2.9)] + [(0.0, x, -3.2) for x in (-1, 0, 1)]
    for mm, sigma_mm, links in heights_of(rim, shifted):
        assert links >= 9
        assert mm == pytest.approx(1.5, abs=0.005)
        assert sigma_mm < 0.02
