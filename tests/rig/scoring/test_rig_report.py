"""The document of a rig run: stable field names, and the two summaries of a board."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from tests.rig.known_boards import report_of, scored
from vaoi_station.rig.rendering import RenderedBoard
from vaoi_station.rig.report import AffectedFrame, BoardScore, Recovery, RigReport


def test_the_document_survives_json(known: RenderedBoard) -> None:
    board = scored(known, {(1, 2): "hit"}, {(1, 2): ("incomplete", "80% arrived")})
    recovery = Recovery(fault="kill", back_s=1.0, ready_after_s=None)
    report = report_of(board, recoveries=(recovery,))
    assert RigReport.model_validate_json(report.model_dump_json()) == report


def test_the_names_of_the_document_are_stable() -> None:
    """Programs read them: a new name is a new version of the format."""
    assert (RigReport.model_fields["format"].default, RigReport.model_fields["version"].default) == ("vaoi-rig", 4)
    assert set(AffectedFrame.model_fields) == {"camera", "row", "verdict", "cause", "done"}
    assert set(Recovery.model_fields) == {"fault", "back_s", "ready_after_s"}
    assert set(BoardScore.model_fields) == {
        "board", "run", "state", "status", "reasons", "cameras", "rows", "rows_due", "ok", "incomplete", "missing",
        "proven", "wrong", "mislit", "affected", "innocent", "unnamed", "unfilmed", "pulse_off_us", "sent_late_ms",
        "notes", "deviation", "ready_after_last_frame_ms", "links_open", "armed_id", "board_id", "held_s",
    }  # fmt: skip


def test_unknown_fields_are_refused(known: RenderedBoard) -> None:
    with pytest.raises(ValidationError, match="surprise"):
        report_of(scored(known), surprise=1)


@pytest.mark.parametrize(
    ("change", "sound", "faultless"),
    [
        ({}, True, True),
        ({"proven": None}, True, True),
        ({"proven": 11}, False, False),
        ({"wrong": ("camera 0, row 0: noise",)}, False, False),
        ({"innocent": ((0, 1),)}, False, False),
        ({"mislit": ("camera 0, row 1: …",)}, False, False),
        ({"unnamed": ((0, 1),)}, False, False),
        ({"notes": ("late",)}, False, False),
        ({"status": "degraded"}, True, False),
        ({"ok": 11, "proven": 11}, True, False),
    ],
)
def test_sound_and_faultless(known: RenderedBoard, change: dict[str, Any], sound: bool, faultless: bool) -> None:
    board = scored(known).model_copy(update=change)
    assert (board.sound, board.faultless) == (sound, faultless)
