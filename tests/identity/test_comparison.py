"""Ids of three sources are compared, and none replaces another."""

from __future__ import annotations

from typing import Any

import pytest

from vaoi_station.identity.comparison import compare
from vaoi_station.model import BoardCode, BoardIdentity, BoardReading, CodePlace
from vaoi_station.model.board_identity import ReportedId

CORNERS = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
PLACE = CodePlace(center=(0.5, 0.5), width=2.0, height=2.0)
ANYWHERE, THERE = BoardIdentity(pattern="b;{id}"), BoardIdentity(pattern="b;{id}", places=(PLACE,))


def code(text: str, panel: Any = None) -> BoardCode:
    return BoardCode(
        text=text, symbology="qr", board_id=THERE.board_id(text), panel=panel, center=(0.5, 0.5), corners=CORNERS,
        module_mm=0.2, error_correction_used=0.0,
    )  # fmt: skip


def reading(*texts: str) -> BoardReading:
    return BoardReading(codes=tuple(map(code, texts)))


@pytest.mark.parametrize(
    ("identity", "read", "armed", "reported", "state", "reasons"),
    [
        (THERE, reading("b;1"), "1", None, "agrees", []),
        (THERE, reading("b;1"), "1", "1", "agrees", []),
        (THERE, reading("b;1"), None, "1", "agrees", []),
        (THERE, reading("b;1"), None, None, "not-compared", []),
        (THERE, reading("b;1"), "2", None, "differs", ["board-id-differs"]),
        (THERE, reading("b;1"), "1", "2", "differs", ["next-machine-differs"]),
        (THERE, reading("b;1"), "01", None, "differs", ["board-id-differs"]),
        (THERE, reading(), "1", None, "unread", ["code-unread"]),
        (THERE, reading(), "1", "2", "differs", ["next-machine-differs", "code-unread"]),
        (THERE, reading("other"), "1", None, "differs", ["product-differs", "code-unread"]),
        (THERE, reading("b;1", "b;2"), "1", None, "differs", ["codes-disagree", "code-unread"][:1]),
        (ANYWHERE, reading("other"), "1", None, "unread", ["code-unread"]),
        (ANYWHERE, reading("other", "b;1"), "1", None, "agrees", []),
        (None, None, "1", None, "not-expected", []),
        (None, None, "1", "2", "differs", ["next-machine-differs"]),
        (THERE, None, "1", None, "not-read", []),
    ],
)
def test_states(
    identity: BoardIdentity | None, read: BoardReading | None, armed: str | None, reported: str | None, state: str,
    reasons: list[str],
) -> None:  # fmt: skip
    found = compare(identity, read, armed, None if reported is None else ReportedId(board_id=reported))
    assert (found.state, [r.code for r in found.reasons]) == (state, reasons)
    assert found.armed_board_id == armed
    assert found.next_machine == (None if reported is None else ReportedId(board_id=reported))


def test_boards_of_a_panel_have_their_own_ids_and_missing_ones_are_named() -> None:
    places = tuple(PLACE.model_copy(update={"panel": name}) for name in (1, 2))
    identity = BoardIdentity(pattern="b;{id}", places=places, required=True)
    both = compare(identity, BoardReading(codes=(code("b;1", 1), code("b;2", 2))), "panel 7")
    assert (both.state, both.board_id, both.boards) == ("not-compared", None, {"1": "1", "2": "2"})
    assert not both.degrades
    one = compare(identity, BoardReading(codes=(code("b;1", 1),), complete=False), "panel 7")
    assert (one.state, one.degrades) == ("unread", True)
    assert "position 2 of the panel before the time for reading ended" in one.reasons[0].message


def test_a_board_of_a_panel_that_is_crossed_out_needs_no_code() -> None:
    places = tuple(PLACE.model_copy(update={"panel": n}) for n in ("1", "2", "3"))
    panel = BoardIdentity(pattern="b;{id}", places=places)
    read = BoardReading(codes=(code("b;1", "1"),))
    assert "position 2 of the panel, position 3" in compare(panel, read, None).reasons[0].message
    found = compare(panel, read, None, skipped=("2",))
    assert [reason.message.split(".")[0] for reason in found.reasons] == ["No code was read of position 3 of the panel"]
    assert compare(panel, read, None, skipped=("2", "3")).reasons == ()


def test_only_a_type_that_requires_its_id_degrades_runs() -> None:
    differs = compare(THERE, reading("b;1"), "2")
    assert not differs.degrades
    required = THERE.model_copy(update={"required": True})
    assert compare(required, reading("b;1"), "2").degrades
    assert compare(required, None, "2").degrades
    assert not compare(required, None, "2", without="pending").degrades
