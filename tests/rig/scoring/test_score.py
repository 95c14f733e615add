"""What a board's run is worth, from its evidence; and what makes a whole rig run fail."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from vaoi_station.rig.devices.pins import Shot
from vaoi_station.rig.line.faults import parse_fault
from vaoi_station.rig.line.films import Film
from vaoi_station.rig.line.stage import Fate, Fired, Passing
from vaoi_station.rig.scoring.rig_report import BoardScore, Recovery, RigReport
from vaoi_station.rig.scoring.ring_check import Sighting
from vaoi_station.rig.scoring.score import Evidence, Trouble, run_of, score
from vaoi_station.rig.scoring.tables import as_text
from vaoi_station.rig.scoring.verdict import failings

PERIOD_NS = 110_000_000


def passing_of(film: Film, fates: dict[tuple[int, int], Fate] | None = None) -> Passing:
    """Fates by (camera, row); the others are sent."""
    given = fates or {}
    fired = [
        Fired(
            row,
            Shot(row, row * PERIOD_NS, (0,), 250.0),
            0.2,
            [given.get((c, row), "sent") for c in range(2)],
            [1.0, 1.0],
            "",
            {c: 20.0 for c in range(2) if (c, row) not in given},
        )
        for row in range(film.rows)
    ]
    return Passing(0, film, 0, 5_000_000_000, fired)


def run_json(film: Film, lost: dict[tuple[int, int], tuple[str, str]]) -> dict[str, Any]:
    """Verdict and cause by (camera, row); the others are ok."""
    frames = []
    for camera in range(2):
        for row in range(film.rows):
            verdict, cause = lost.get((camera, row), ("ok", ""))
            frames.append({"camera": camera, "row": row, "verdict": verdict, "cause": cause})
    return {"id": "r1", "state": "ready", "verdict": "ok", "reasons": [], "frames": frames, "timings": None}


def scored(
    film: Film,
    fates: dict[tuple[int, int], Fate] | None = None,
    lost: dict[tuple[int, int], tuple[str, str]] | None = None,
    wrong: dict[tuple[int, int], str] | None = None,
    troubles: tuple[Trouble, ...] = (),
) -> BoardScore:
    """With matrices that are the truth itself."""
    cells = {(c, r) for c in range(2) for r in range(film.rows)}
    whole = frozenset(cells - set(lost or {}) - set(wrong or {}))
    evidence = Evidence(
        passing_of(film, fates),
        run_json(film, lost or {}),
        {"components": film.sheet.views},
        Sighting(whole, frozenset(), wrong or {}),
        [18.0, 18.0],
    )
    return score(evidence, troubles)


def report_of(*boards: BoardScore, **more: Any) -> RigReport:
    return RigReport(
        **{
            "ok": True, "scenario": "small", "cameras": 2, "width_px": 640, "height_px": 480, "frames_per_s": 9.09,
            "faults": (), "boards": boards, "boards_missed": 0, "stray_pulses": 0, "rms_px": 0.01, "max_px": 0.02,
            "recoveries": (), "load": None, "machine_load": 0.1, "took_s": 9.0, "failings": (), **more,
        }
    )  # fmt: skip


def test_a_board_without_faults(filmed: tuple[Film, ...]) -> None:
    board = scored(filmed[0])
    assert board.faultless
    assert (board.ok, board.proven, board.rows, board.pulse_off_us) == (2 * board.rows, board.ok, filmed[0].rows, 0.2)
    assert (board.deviation.unplaced, board.deviation.max_px) == (0, 0.0)
    assert failings(report_of(board), [], 1) == ()
    assert "all is as it must be" in as_text(report_of(board))


def test_what_was_done_to_a_frame_is_told_beside_what_the_station_says(filmed: tuple[Film, ...]) -> None:
    board = scored(filmed[0], {(1, 2): "hit"}, {(1, 2): ("incomplete", "80% came through")})
    [named] = board.affected
    assert (named.camera, named.row, named.done) == (1, 2, "packets were lost")
    assert board.sound
    assert not board.faultless
    assert failings(report_of(board), [parse_fault("loss")], 1) == ()
    assert "board 0, camera 1, row 2: incomplete, '80% came through' (packets were lost)" in as_text(report_of(board))


def test_rows_with_one_story_are_told_together(filmed: tuple[Film, ...]) -> None:
    fates: dict[tuple[int, int], Fate] = {(1, row): "dead" for row in (1, 2, 3, 5)}
    board = scored(filmed[0], fates, dict.fromkeys(fates, ("missing", "it was lost")))
    assert "board 0, camera 1, row 1–3, 5: missing, 'it was lost' (the camera was dead)" in as_text(report_of(board))


def test_a_frame_lost_without_a_reason_is_told(filmed: tuple[Film, ...]) -> None:
    board = scored(filmed[0], None, {(0, 1): ("missing", "lost"), (1, 1): ("missing", "")})
    assert board.innocent == ((0, 1), (1, 1))
    assert board.unnamed == ((1, 1),)
    words = failings(report_of(board), [], 1)
    assert "board 0: camera 0, row 1 is not whole, and nothing was done to it" in words
    assert "board 0: camera 1, row 1 is not whole, and no cause is told" in words


def test_a_rig_that_was_late_itself_says_so(filmed: tuple[Film, ...]) -> None:
    """Then nothing can be said of the station."""
    passing = passing_of(filmed[0])
    passing.fired[5].sent_ms[0] = 700.0
    run = run_json(filmed[0], {(0, 5): ("missing", "no frame came")})
    board = score(Evidence(passing, run, {"components": filmed[0].sheet.views}, None, [18.0, 18.0]), ())
    assert (board.innocent, board.sent_late_ms) == ((), 700.0)
    assert board.affected[0].done == "the rig sent it 700 ms late"
    assert any("too busy for a verdict" in words for words in failings(report_of(board), [], 1))
    del passing.fired[5].sent_ms[0]
    never = score(Evidence(passing, run, {"components": filmed[0].sheet.views}, None, [18.0, 18.0]), ())
    assert (never.sent_late_ms, never.affected[0].done) == (None, "the rig never sent it")


def test_a_whole_board_has_nothing_to_say(filmed: tuple[Film, ...]) -> None:
    board = scored(filmed[0]).model_copy(update={"reasons": ("Camera 0: it runs freely.",)})
    assert failings(report_of(board), [], 1) == ("board 0 is ok, but says: Camera 0: it runs freely.",)


def test_pixels_of_another_row_are_told(filmed: tuple[Film, ...]) -> None:
    board = scored(filmed[0], wrong={(0, 3): "it is the frame of camera 0, row 2"})
    words = failings(report_of(board), [], 1)
    assert "board 0: camera 0, row 3: it is the frame of camera 0, row 2" in words
    assert "board 0: 1 frame(s) that are told to be whole are not in the ring" in words


def test_trouble_excuses_its_own_camera_and_time(filmed: tuple[Film, ...]) -> None:
    lost = {(0, 2): ("missing", "gone"), (0, 5): ("missing", "gone"), (1, 2): ("missing", "gone")}
    trouble = Trouble(2 * PERIOD_NS, 3 * PERIOD_NS, 0, "the camera was dead")
    board = scored(filmed[0], None, lost, troubles=(trouble,))
    assert board.innocent == ((0, 5), (1, 2))
    everywhere = replace(trouble, camera=None, until_ns=9 * PERIOD_NS)
    assert scored(filmed[0], None, lost, troubles=(everywhere,)).innocent == ()


def test_rows_that_were_never_fired_need_a_word(filmed: tuple[Film, ...]) -> None:
    board = scored(filmed[0]).model_copy(update={"rows": 4})
    assert "only 4 of 6 rows were fired, and the station does not tell why" in failings(report_of(board), [], 1)[0]
    told = board.model_copy(update={"reasons": ("After row 3 nothing more was filmed: the controller was reset.",)})
    assert failings(report_of(told), [parse_fault("reset:board=0,row=4")], 1) == ()
    assert "board 0, 4 of 6 rows: After row 3 nothing more was filmed" in as_text(report_of(told))


def test_a_board_without_a_run(filmed: tuple[Film, ...]) -> None:
    board = score(Evidence(passing_of(filmed[0]), None, {}, None, [18.0, 18.0]), ())
    assert (board.run, board.unfilmed) == (None, 2 * filmed[0].rows)
    assert failings(report_of(board), [], 2) == ("only 1 of 2 boards passed", "board 0 was not filmed")


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
def test_what_makes_a_run_fail(filmed: tuple[Film, ...], change: dict[str, Any], words: str) -> None:
    assert failings(report_of(scored(filmed[0]), **change), [], 1) == (words,)


def test_a_run_is_of_the_board_that_interrupted_the_barrier_then(filmed: tuple[Film, ...]) -> None:
    passing = passing_of(filmed[0])
    runs = [{"id": "before"}, {"id": "its"}]
    assert run_of(passing, runs, {"before": 2.0, "its": 5.01}) == "its"
    assert run_of(passing, runs, {"before": 2.0, "its": 5.6}) is None
    assert run_of(passing, [], {}) is None
