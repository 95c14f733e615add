"""The orientation by a reference: of a board of the twin whose fiducials, outline and parts fit both ways."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from vaoi_station.model import BoardType, Status, Stitch
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.stitching.board.reference import Reference
from vaoi_station.stitching.recordings.references import awaits_confirmation, with_confirmed_orientation
from vaoi_station.stitching.work import stitch_frames


def symmetric(board_type: BoardType) -> BoardType:
    """Leave two fiducials, and neither outline nor components: the board turned by 180° fits as well."""
    data = board_type.model_dump(mode="json", exclude_none=True)
    data |= {"fiducials": data["fiducials"][:2], "components": []}
    data.pop("outline")
    return BoardType.model_validate(data)


@pytest.fixture(scope="module")
def kind(filmed: Any) -> BoardType:
    return symmetric(filmed.board_type)


@pytest.fixture(scope="module")
def reference(filmed: Any, kind: BoardType) -> Stitch:
    """The first board, taught with the confirmation of a person."""
    found = filmed.stitched(board_type=kind)
    assert awaits_confirmation(found), found.reasons
    return with_confirmed_orientation(found)


def against(filmed: Any, reference: Stitch, kind: BoardType, run: Any) -> Stitch:
    """Stitch a run against the reference, whose frames are those of `filmed`."""
    known = Reference(reference, frozenset(filmed.frames), "r", reference.quality["cad_sigma_px"])
    setup = replace(filmed.setup, board_type=kind, reference=known)
    return stitch_frames(setup, run.head(), run.frame, filmed.frame)


def passage(turned_deg: int) -> Any:
    """Return the passage of the second board, perhaps turned on the belt."""
    scenario = read_scenario(scenario_path("small"))
    board = scenario.board.model_copy(update={"turned_deg": turned_deg})
    return Twin(scenario.model_copy(update={"board": board})).passage(1)


def test_without_a_reference_the_board_may_lie_either_way(filmed: Any, kind: BoardType) -> None:
    result = filmed.stitched(board_type=kind)
    assert result.status is Status.DEGRADED
    assert result.quality["orientation"] == "ambiguous"
    assert "--confirm-orientation" in result.reasons[0]


def test_a_confirmed_reference_settles_the_orientation(filmed: Any, kind: BoardType, reference: Stitch) -> None:
    result = against(filmed, reference, kind, passage(0))
    assert (result.status, result.reasons) == (Status.OK, ())
    assert result.quality["orientation"] == "certain"


def test_a_turned_board_fails_with_its_reason(filmed: Any, kind: BoardType, reference: Stitch) -> None:
    result = against(filmed, reference, kind, passage(180))
    assert result.status is Status.FAILED
    assert "turned by 180°" in result.reasons[0]
    assert "match the reference only when turned" in result.reasons[0]


def test_a_confirmation_settles_nothing_but_the_orientation(filmed: Any, kind: BoardType, reference: Stitch) -> None:
    assert (reference.status, reference.quality["orientation"]) == (Status.OK, "confirmed")
    frames = {key: pixels for key, pixels in filmed.frames.items() if key[0] == 0}
    worse = filmed.stitched(board_type=filmed.board_type, frames=frames)
    assert not awaits_confirmation(worse)
    assert with_confirmed_orientation(worse) is worse
