"""Components compared with a reference: boards of the twin of the same type, and one of another type."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from vaoi_station.model import Status, Stitch
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.stitching.board.reference import Reference
from vaoi_station.stitching.components.other_type import Likeness, shown_by_points
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


@pytest.mark.parametrize(
    ("compared", "alike", "other"), [(16, 0, True), (16, 4, True), (16, 5, False), (5, 1, True), (4, 0, False)]
)
def test_nearly_all_components_must_differ(compared: int, alike: int, other: bool) -> None:
    assert Likeness(compared, alike).other_type is other


def test_without_a_reference_nothing_is_shown_by_its_points(filmed: Any) -> None:
    assert not shown_by_points(filmed.setup.plane, None, np.zeros((0, 2)))
