"""Parts that the board type does not list, on films of the twin with known truth."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from tests.hostile.judging import judge
from vaoi_station.model import BoardType, ReasonCode, Status, Stitch
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.stitching.board.reference import Reference
from vaoi_station.stitching.work import stitch_frames


def filmed_against(filmed: Any, reference: Stitch, section: str, **changes: Any) -> Stitch:
    """Stitch a board of a changed scenario, by the board type and against the reference of the first one."""
    scenario = read_scenario(scenario_path("small"))
    changed = getattr(scenario, section).model_copy(update=changes)
    run = Twin(scenario.model_copy(update={section: changed})).passage(1)
    known = Reference(reference, frozenset(filmed.frames), "r", reference.quality["cad_sigma_px"])
    return stitch_frames(replace(filmed.setup, reference=known), run.head(), run.frame, filmed.frame)


@pytest.fixture(scope="module")
def reference(filmed: Any) -> Stitch:
    result: Stitch = filmed.stitched()
    return result


def test_a_board_of_another_type_is_named(filmed: Any, reference: Stitch) -> None:
    """Fiducials, outline and holes are the same, so that positions are right; the components are others."""
    seed = read_scenario(scenario_path("small")).board.seed
    result = filmed_against(filmed, reference, "board", seed=seed + 1)
    assert result.status is Status.DEGRADED
    assert [reason for reason in result.reasons if "components look as in the reference" in reason]


def test_a_board_in_much_less_light_is_no_other_type(filmed: Any, reference: Stitch) -> None:
    gain = read_scenario(scenario_path("small")).array.gain
    result = filmed_against(filmed, reference, "array", gain=0.4 * gain)
    assert (result.status, result.reasons) == (Status.OK, ())


def other_board(filmed: Any, number: int) -> BoardType:
    """Return a board type of the same size and fiducials with other parts."""
    scenario = read_scenario(scenario_path("small"))
    section = scenario.board.model_copy(update={"seed": scenario.board.seed + number})
    return Twin(scenario.model_copy(update={"board": section})).board_type


def test_a_board_of_another_type_without_a_reference_is_named(filmed: Any) -> None:
    """Fiducials and outline fit, and nothing else: before, such a run was `ok`, with pictures of other places."""
    results = [filmed.stitched(board_type=other_board(filmed, n)) for n in range(1, 7)]
    assert {result.status for result in results} == {Status.DEGRADED}
    named = [r for r in results if ReasonCode.UNLISTED_PARTS in r.reason_codes]
    assert len(named) >= 4, "in the others, parts look symmetric at the places of the data by chance"


def test_a_drawing_of_another_type_that_was_wrong_is_named() -> None:
    """Links on the other parts bent the estimated surface: positions are off by 0.11 and 0.13 px at a σ of 0.02."""
    outcome = judge(109882)
    assert (outcome.status, outcome.finds) == ("degraded", ())
    assert any("has none" in reason for reason in outcome.reasons)
