"""The report of a rig run, its failings and its text."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

import pytest

from tests.rig.known_boards import evidence_of, report_of, scored
from vaoi_station.rig.faults import Fault, parse_fault
from vaoi_station.rig.rendering import RenderedBoard
from vaoi_station.rig.report import (
    AffectedFrame,
    BoardScore,
    Recovery,
    RigReport,
    failings,
)
from vaoi_station.rig.score import score


def failings_of(report: RigReport, faults: Sequence[Fault], boards: int) -> tuple[str, ...]:
    return tuple(failings(report, faults, boards))


def test_the_names_of_the_document_are_stable() -> None:
    """Programs read them: a new name is a new version of the format."""
    assert (RigReport.model_fields["format"].default, RigReport.model_fields["version"].default) == ("vaoi-rig", 5)
    assert set(AffectedFrame.model_fields) == {"camera", "row", "verdict", "cause", "done"}
    assert set(Recovery.model_fields) == {"fault", "back_s", "ready_after_s"}
    assert set(BoardScore.model_fields) == {
        "board", "run", "status", "reasons", "rows", "rows_due", "ok", "incomplete", "missing",
        "proven", "wrong", "mislit", "affected", "unfilmed", "pulse_off_us", "sent_late_ms",
        "notes", "deviation", "ready_after_last_frame_ms", "links_open", "armed_id", "board_id", "held_s",
    }  # fmt: skip


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"boards_missed": 2}, "the station missed 2 board(s)"),
        ({"stray_pulses": 1}, "1 pulse(s) were fired while no board passed"),
        ({"rms_px": 0.11}, "component positions are off by 0.11 px rms, the limit is 0.1"),
        (
            {"recoveries": (Recovery(fault="kill", back_s=5.0, ready_after_s=12.5),)},
            "after kill it took 12.5 s to be ready, the limit is 12.0",
        ),
        (
            {"recoveries": (Recovery(fault="reset", back_s=5.0, ready_after_s=None),)},
            "after reset the station did not become ready again",
        ),
    ],
)
def test_figures_beyond_their_limits(known: RenderedBoard, change: dict[str, Any], sentence: str) -> None:
    assert failings_of(report_of(scored(known), **change), [], 1) == (sentence,)


LOST = AffectedFrame(camera=1, row=2, verdict="missing", cause="it was lost", done="the camera was dead")
NOT_WHOLE = "board 0: camera 1, row 2 is not whole"


@pytest.mark.parametrize(
    ("change", "sentence"),
    [
        ({"proven": None}, "board 0: its pixels could not be checked"),
        ({"proven": 10}, "board 0: 2 frame(s) reported as whole are not in the ring"),
        ({"wrong": ("camera 0, row 3: noise",)}, "board 0: camera 0, row 3: noise"),
        ({"notes": ("fired twice",)}, "board 0: fired twice"),
        ({"mislit": ("camera 1, row 2: the station states …",)}, "board 0: camera 1, row 2: the station states …"),
        ({"affected": (LOST.model_copy(update={"done": ""}),)}, f"{NOT_WHOLE}, and no fault was injected"),
        ({"affected": (LOST.model_copy(update={"cause": ""}),)}, f"{NOT_WHOLE}, and the station reports no cause"),
        ({"unfilmed": 3}, "board 0: the station does not list 3 frame(s) that were fired"),
        ({"reasons": ("Camera 0: slow.",)}, "board 0 is ok, but has reasons: Camera 0: slow."),
        ({"status": "degraded"}, "board 0 is degraded: "),
    ],
)
def test_what_is_wrong_with_a_board(known: RenderedBoard, change: dict[str, Any], sentence: str) -> None:
    board = scored(known).model_copy(update=change)
    assert failings_of(report_of(board), [], 1) == (sentence,)


def test_missing_rows_need_a_reason_unless_a_fault_explains_them(known: RenderedBoard) -> None:
    board = scored(known).model_copy(update={"rows": 4})
    assert failings_of(report_of(board), [], 1) == (
        "board 0: only 4 of 6 rows were fired, and the station reports no reason",
        "board 0: only 4 of 6 rows were fired",
    )
    explained = board.model_copy(update={"reasons": ("The controller was reset.",), "status": "failed"})
    for fault in ("reset:board=0", "stuck:board=0", "stall:board=0,who=acquisition"):
        assert failings_of(report_of(explained), [parse_fault(fault)], 1) == ()
    assert failings_of(report_of(explained), [parse_fault("reset:board=1")], 1) != ()


@pytest.mark.parametrize(("sent_ms", "words"), [(700.0, "by 700 ms"), (None, "without end")])
def test_a_rig_that_delays_frames_is_no_judge(known: RenderedBoard, sent_ms: float | None, words: str) -> None:
    evidence = evidence_of(known, None, {(0, 5): ("missing", "no frame came")})
    if sent_ms is None:
        del evidence.passage.fired[5].sent_ms[0]
    else:
        evidence.passage.fired[5].sent_ms[0] = sent_ms
    [sentence] = failings_of(report_of(score(evidence, ())), [], 1)
    assert sentence == f"board 0: the rig itself delayed frames {words}: this machine is too busy for a verdict"


@pytest.mark.parametrize(
    ("runs", "missed", "accounted"), [(1, 1, True), (2, 0, True), (1, 0, False), (1, 2, False), (2, 1, False)]
)
def test_every_board_that_follows_is_a_run_or_missed(
    known: RenderedBoard, runs: int, missed: int, accounted: bool
) -> None:
    report = report_of(scored(known), boards_missed=missed, runs=runs)
    sentence = f"2 boards met the barrier, but the station has {runs} run(s) and {missed} missed board(s)"
    assert failings_of(report, [parse_fault("follow:board=0")], 1) == (() if accounted else (sentence,))


@pytest.mark.parametrize(
    ("board_id", "reasons", "sentence"),
    [
        ("board-0", (), None),
        ("board-1", (), "board 0: its run has the board id 'board-1', armed was 'board-0'"),
        (None, (), "board 0: its run has no board id and no reason, armed was 'board-0'"),
        (None, ("This run has no board id.",), None),
    ],
)
def test_a_run_has_the_id_of_its_own_board(
    known: RenderedBoard, board_id: str | None, reasons: tuple[str, ...], sentence: str | None
) -> None:
    change = {"armed_id": "board-0", "board_id": board_id, "reasons": reasons, "status": "degraded"}
    found = failings_of(report_of(scored(known).model_copy(update=change)), [parse_fault("reset:board=0")], 1)
    assert found == (() if sentence is None else (sentence,))
