"""The report as text for people."""

from __future__ import annotations

import re

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.rig.known_boards import evidence_of, report_of, scored
from vaoi_station.rig.line import FrameOutcome
from vaoi_station.rig.rendering import RenderedBoard
from vaoi_station.rig.report import MOST, AffectedFrame, Recovery, as_text
from vaoi_station.rig.score import BoardEvidence, score


def affected(known: RenderedBoard, rows: list[int]) -> str:
    """The lines about frames of one camera with one common fault."""
    frames = tuple(AffectedFrame(camera=1, row=row, verdict="missing", cause="lost", done="dead") for row in rows)
    board = scored(known).model_copy(update={"affected": frames})
    return "\n".join(line for line in as_text(report_of(board)).splitlines() if ", row " in line)


def test_the_columns_stand_under_their_titles(known: RenderedBoard) -> None:
    _, head, row, *_ = as_text(report_of(scored(known))).splitlines()
    assert len(head) == len(row)
    assert head.split()[:4] == ["board", "verdict", "ok", "incomplete"]
    assert row.split() == ["0", "ok", "12", "0", "0", "12", "0.20", "20", "0.000", "0.000", "–", "–"]


def test_the_first_line_names_scenario_array_and_faults(known: RenderedBoard) -> None:
    text = as_text(report_of(scored(known), faults=("loss:share=0.1", "reset")))
    assert text.splitlines()[0] == (
        "scenario 'small': 2 cameras, 640 × 480 at 9.09 frames/s; faults: loss:share=0.1, reset"
    )
    assert "faults: none" in as_text(report_of(scored(known)))


def test_the_end_states_whether_all_checks_passed(known: RenderedBoard) -> None:
    assert as_text(report_of(scored(known))).splitlines()[-1] == "took 9 s: all checks passed"
    failed = as_text(report_of(scored(known), ok=False, failings=("board 0 has no run",)))
    assert failed.splitlines()[-2:] == ["took 9 s: checks FAILED", "  - board 0 has no run"]


def test_a_board_without_a_run_has_no_figures(known: RenderedBoard) -> None:
    evidence = evidence_of(known)
    row = as_text(report_of(score(BoardEvidence(evidence.passage, None, {}, None, [18.0]), ()))).splitlines()[2]
    assert row.split()[:3] == ["0", "no", "run"]
    assert row.split()[-4:] == ["–"] * 4


def test_a_lost_frame_is_listed_with_cause_and_fault(known: RenderedBoard) -> None:
    board = scored(known, {(1, 2): "hit"}, {(1, 2): ("incomplete", "80% arrived")})
    assert "  board 0, camera 1, row 2: incomplete, '80% arrived' (packets were lost)" in as_text(report_of(board))
    innocent = scored(known, None, {(0, 1): ("missing", "lost")})
    assert "row 1: missing, 'lost' (NO fault was injected)" in as_text(report_of(innocent))


def test_rows_with_one_cause_share_a_line(known: RenderedBoard) -> None:
    outcomes: dict[tuple[int, int], FrameOutcome] = {(1, row): "dead" for row in (1, 2, 3, 5)}
    board = scored(known, outcomes, dict.fromkeys(outcomes, ("missing", "it was lost")))
    assert "board 0, camera 1, row 1–3, 5: missing, 'it was lost' (the camera was dead)" in as_text(report_of(board))


@given(rows=st.sets(st.integers(0, 40), min_size=1))
def test_ranges_of_rows_name_every_row_once(tmp_path_factory: pytest.TempPathFactory, rows: set[int]) -> None:
    from tests.rig.known_boards import known_board

    line = affected(known_board(tmp_path_factory.getbasetemp() / "ranges"), sorted(rows, reverse=True))
    found: list[int] = []
    match = re.search(r"row (.*?): missing", line)
    assert match is not None
    for span in match[1].split(", "):
        first, _, last = span.partition("–")
        found += range(int(first), int(last or first) + 1)
    assert found == sorted(rows)


def test_a_long_list_of_frames_is_cut(known: RenderedBoard) -> None:
    frames = tuple(AffectedFrame(camera=n, row=1, verdict="missing", cause="", done="dead") for n in range(MOST + 5))
    text = as_text(report_of(scored(known).model_copy(update={"affected": frames})))
    assert text.count("camera ") == MOST
    assert "  … and 5 more" in text


def test_reasons_are_listed_unless_they_only_list_frames(known: RenderedBoard) -> None:
    reasons = ("After row 3 nothing more was recorded.", "Frames (camera, row) are missing: (0, 4).")
    text = as_text(report_of(scored(known).model_copy(update={"rows": 4, "reasons": reasons})))
    assert "  board 0, 4 of 6 rows: After row 3 nothing more was recorded." in text
    assert "(0, 4)" not in text


def test_recoveries_have_a_line_each(known: RenderedBoard) -> None:
    recoveries = (
        Recovery(fault="kill", back_s=5.0, ready_after_s=0.42),
        Recovery(fault="reset", back_s=7.5, ready_after_s=None),
    )
    text = as_text(report_of(scored(known), recoveries=recoveries))
    assert "kill: over at 5.0 s, the station was ready 0.4 s later" in text
    assert "reset: over at 7.5 s, the station was ready never" in text
