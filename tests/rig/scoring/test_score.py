"""What a board's run is worth, from its evidence; and what makes a whole rig run fail."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from vaoi_station.rig.devices.pulses import Pulse
from vaoi_station.rig.line.faults import parse_fault
from vaoi_station.rig.line.rendered_boards import RenderedBoard
from vaoi_station.rig.line.virtual_line import BoardPassage, FiredPulse, FrameOutcome
from vaoi_station.rig.scoring.rig_report import BoardScore, Recovery, RigReport
from vaoi_station.rig.scoring.ring_check import RingCheck
from vaoi_station.rig.scoring.score import BoardEvidence, Outage, run_of, score
from vaoi_station.rig.scoring.tables import as_text
from vaoi_station.rig.scoring.verdict import failings

PERIOD_NS = 110_000_000


def passing_of(film: RenderedBoard, outcomes: dict[tuple[int, int], FrameOutcome] | None = None) -> BoardPassage:
    """Fates by (camera, row); the others are sent."""
    given = outcomes or {}
    fired = [
        FiredPulse(
            row,
            Pulse(row, row * PERIOD_NS, (0,), 250.0),
            0.2,
            [given.get((c, row), "sent") for c in range(2)],
            [1.0, 1.0],
            "",
            {c: 20.0 for c in range(2) if (c, row) not in given},
        )
        for row in range(film.rows)
    ]
    return BoardPassage(0, film, 0, 5_000_000_000, fired)


def run_json(film: RenderedBoard, lost: dict[tuple[int, int], tuple[str, str]]) -> dict[str, Any]:
    """Verdict and cause by (camera, row); the others are ok."""
    frames = []
    for camera in range(2):
        for row in range(film.rows):
            verdict, cause = lost.get((camera, row), ("ok", ""))
            frames.append({"camera": camera, "row": row, "verdict": verdict, "cause": cause})
    return {"id": "r1", "state": "ready", "verdict": "ok", "reasons": [], "frames": frames, "timings": None}


def scored(
    film: RenderedBoard,
    outcomes: dict[tuple[int, int], FrameOutcome] | None = None,
    lost: dict[tuple[int, int], tuple[str, str]] | None = None,
    wrong: dict[tuple[int, int], str] | None = None,
    outages: tuple[Outage, ...] = (),
) -> BoardScore:
    """With matrices that are the truth itself."""
    cells = {(c, r) for c in range(2) for r in range(film.rows)}
    whole = frozenset(cells - set(lost or {}) - set(wrong or {}))
    evidence = BoardEvidence(
        passing_of(film, outcomes),
        run_json(film, lost or {}),
        {"components": film.metadata.views},
        RingCheck(whole, frozenset(), wrong or {}),
        [18.0, 18.0],
    )
    return score(evidence, outages)


def report_of(*boards: BoardScore, **more: Any) -> RigReport:
    return RigReport(
        **{
            "ok": True, "scenario": "small", "cameras": 2, "width_px": 640, "height_px": 480, "frames_per_s": 9.09,
            "faults": (), "boards": boards, "boards_missed": 0, "stray_pulses": 0, "rms_px": 0.01, "max_px": 0.02,
            "recoveries": (), "load": None, "machine_load": 0.1, "took_s": 9.0, "failings": (), **more,
        }
    )  # fmt: skip


def test_a_board_without_faults(filmed: tuple[RenderedBoard, ...]) -> None:
    board = scored(filmed[0])
    assert board.faultless
    assert (board.ok, board.proven, board.rows, board.pulse_off_us) == (2 * board.rows, board.ok, filmed[0].rows, 0.2)
    assert (board.deviation.unplaced, board.deviation.max_px) == (0, 0.0)
    assert failings(report_of(board), [], 1) == ()
    assert "all checks passed" in as_text(report_of(board))


def test_what_was_done_to_a_frame_is_told_beside_what_the_station_says(filmed: tuple[RenderedBoard, ...]) -> None:
    board = scored(filmed[0], {(1, 2): "hit"}, {(1, 2): ("incomplete", "80% came through")})
    [named] = board.affected
    assert (named.camera, named.row, named.done) == (1, 2, "packets were lost")
    assert board.sound
    assert not board.faultless
    assert failings(report_of(board), [parse_fault("loss")], 1) == ()
    assert "board 0, camera 1, row 2: incomplete, '80% came through' (packets were lost)" in as_text(report_of(board))


def test_rows_with_one_story_are_told_together(filmed: tuple[RenderedBoard, ...]) -> None:
    outcomes: dict[tuple[int, int], FrameOutcome] = {(1, row): "dead" for row in (1, 2, 3, 5)}
    board = scored(filmed[0], outcomes, dict.fromkeys(outcomes, ("missing", "it was lost")))
    assert "board 0, camera 1, row 1–3, 5: missing, 'it was lost' (the camera was dead)" in as_text(report_of(board))


def test_a_frame_lost_without_a_fault_is_reported(filmed: tuple[RenderedBoard, ...]) -> None:
    board = scored(filmed[0], None, {(0, 1): ("missing", "lost"), (1, 1): ("missing", "")})
    assert board.innocent == ((0, 1), (1, 1))
    assert board.unnamed == ((1, 1),)
    words = failings(report_of(board), [], 1)
    assert "board 0: camera 0, row 1 is not whole, and no fault was injected" in words
    assert "board 0: camera 1, row 1 is not whole, and the station reports no cause" in words


def test_a_rig_that_was_late_itself_says_so(filmed: tuple[RenderedBoard, ...]) -> None:
    """Then nothing can be said of the station."""
    passage = passing_of(filmed[0])
    passage.fired[5].sent_ms[0] = 700.0
    run = run_json(filmed[0], {(0, 5): ("missing", "no frame came")})
    board = score(BoardEvidence(passage, run, {"components": filmed[0].metadata.views}, None, [18.0, 18.0]), ())
    assert (board.innocent, board.sent_late_ms) == ((), 700.0)
    assert board.affected[0].done == "the rig sent it 700 ms late"
    assert any("too busy for a verdict" in words for words in failings(report_of(board), [], 1))
    del passage.fired[5].sent_ms[0]
    never = score(BoardEvidence(passage, run, {"components": filmed[0].metadata.views}, None, [18.0, 18.0]), ())
    assert (never.sent_late_ms, never.affected[0].done) == (None, "the rig never sent it")


def test_a_whole_board_has_nothing_to_say(filmed: tuple[RenderedBoard, ...]) -> None:
    board = scored(filmed[0]).model_copy(update={"reasons": ("Camera 0: it runs freely.",)})
    assert failings(report_of(board), [], 1) == ("board 0 is ok, but has reasons: Camera 0: it runs freely.",)


def test_pixels_of_another_row_are_reported(filmed: tuple[RenderedBoard, ...]) -> None:
    board = scored(filmed[0], wrong={(0, 3): "it is the frame of camera 0, row 2"})
    words = failings(report_of(board), [], 1)
    assert "board 0: camera 0, row 3: it is the frame of camera 0, row 2" in words
    assert "board 0: 1 frame(s) reported as whole are not in the ring" in words


def test_trouble_excuses_its_own_camera_and_time(filmed: tuple[RenderedBoard, ...]) -> None:
    lost = {(0, 2): ("missing", "gone"), (0, 5): ("missing", "gone"), (1, 2): ("missing", "gone")}
    outage = Outage(2 * PERIOD_NS, 3 * PERIOD_NS, 0, "the camera was dead")
    board = scored(filmed[0], None, lost, outages=(outage,))
    assert board.innocent == ((0, 5), (1, 2))
    everywhere = replace(outage, camera=None, until_ns=9 * PERIOD_NS)
    assert scored(filmed[0], None, lost, outages=(everywhere,)).innocent == ()


def test_rows_that_were_never_fired_need_a_word(filmed: tuple[RenderedBoard, ...]) -> None:
    board = scored(filmed[0]).model_copy(update={"rows": 4})
    assert "only 4 of 6 rows were fired, and the station reports no reason" in failings(report_of(board), [], 1)[0]
    told = board.model_copy(update={"reasons": ("After row 3 nothing more was filmed: the controller was reset.",)})
    assert failings(report_of(told), [parse_fault("reset:board=0,row=4")], 1) == ()
    assert "board 0, 4 of 6 rows: After row 3 nothing more was filmed" in as_text(report_of(told))


def test_a_board_without_a_run(filmed: tuple[RenderedBoard, ...]) -> None:
    board = score(BoardEvidence(passing_of(filmed[0]), None, {}, None, [18.0, 18.0]), ())
    assert (board.run, board.unfilmed) == (None, 2 * filmed[0].rows)
    assert failings(report_of(board), [], 2) == ("only 1 of 2 boards passed", "board 0 has no run")


@pytest.mark.parametrize(
    ("change", "words"),
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
def test_what_makes_a_run_fail(filmed: tuple[RenderedBoard, ...], change: dict[str, Any], words: str) -> None:
    assert failings(report_of(scored(filmed[0]), **change), [], 1) == (words,)


def test_a_run_is_of_the_board_that_interrupted_the_barrier_then(filmed: tuple[RenderedBoard, ...]) -> None:
    passage = passing_of(filmed[0])
    runs = [{"id": "before"}, {"id": "its"}]
    assert run_of(passage, runs, {"before": 2.0, "its": 5.01}) == "its"
    assert run_of(passage, runs, {"before": 2.0, "its": 5.6}) is None
    assert run_of(passage, [], {}) is None
