"""Score one board from its evidence."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.rig.known_boards import CAMERAS, PERIOD_NS, ROWS, evidence_of, passage_of, run_json, scored
from vaoi_station.rig.devices import IN_FLIGHT_S, Outage
from vaoi_station.rig.line import FrameOutcome, Lighting
from vaoi_station.rig.rendering import RenderedBoard
from vaoi_station.rig.score import RUN_MATCH_S, BoardEvidence, run_of, score


def test_a_board_without_faults(known: RenderedBoard) -> None:
    board = scored(known)
    assert board.faultless
    assert board.sound
    assert (board.ok, board.incomplete, board.missing) == (CAMERAS * ROWS, 0, 0)
    assert (board.proven, board.rows, board.rows_due, board.pulse_off_us) == (board.ok, ROWS, ROWS, 0.2)
    assert (board.deviation.views, board.deviation.unplaced, board.deviation.max_px) == (3, 0, 0.0)
    assert (board.affected, board.innocent, board.unnamed, board.wrong, board.unfilmed) == ((), (), (), (), 0)


@pytest.mark.parametrize(
    ("outcome", "done"),
    [
        ("ignored", "the camera ignored the pulse"),
        ("hit", "packets were lost"),
        ("lost", "all packets were lost"),
        ("dead", "the camera was dead"),
    ],
)
def test_a_lost_frame_is_listed_with_its_fault(known: RenderedBoard, outcome: FrameOutcome, done: str) -> None:
    board = scored(known, {(1, 2): outcome}, {(1, 2): ("incomplete", "80% arrived")})
    [frame] = board.affected
    assert (frame.camera, frame.row, frame.verdict, frame.cause, frame.done) == (
        1, 2, "incomplete", "80% arrived", done,
    )  # fmt: skip
    assert (board.ok, board.incomplete) == (CAMERAS * ROWS - 1, 1)
    assert board.sound
    assert not board.faultless


def test_a_frame_lost_without_a_fault_is_reported(known: RenderedBoard) -> None:
    board = scored(known, None, {(0, 1): ("missing", "lost"), (1, 1): ("missing", "")})
    assert board.innocent == ((0, 1), (1, 1))
    assert board.unnamed == ((1, 1),)
    assert board.missing == 2
    assert not board.sound


def test_a_frame_that_the_rig_sent_late_is_the_rigs(known: RenderedBoard) -> None:
    lost = {(0, 5): ("missing", "no frame came")}
    evidence = evidence_of(known, None, lost)
    evidence.passage.fired[5].sent_ms[0] = 700.0
    board = score(evidence, ())
    assert (board.innocent, board.sent_late_ms) == ((), 700.0)
    assert board.affected[0].done == "the rig sent it 700 ms late"
    del evidence.passage.fired[5].sent_ms[0]
    never = score(evidence, ())
    assert (never.sent_late_ms, never.affected[0].done) == (None, "the rig never sent it")


def test_frames_that_a_fault_took_do_not_count_as_late(known: RenderedBoard) -> None:
    assert scored(known, {(0, 1): "dead", (1, 4): "ignored"}).sent_late_ms == 20.0


def test_pixels_of_another_row_are_reported(known: RenderedBoard) -> None:
    board = scored(known, wrong={(0, 3): "it is the frame of camera 0, row 2"})
    assert board.wrong == ("camera 0, row 3: it is the frame of camera 0, row 2",)
    assert board.proven == board.ok - 1
    assert not board.sound


@pytest.mark.parametrize(
    ("stated", "words"),
    [
        ({}, ()),
        ({"light": "left"}, ("camera 1, row 3: the station states the light 'left', lit was 'ring'",)),
        ({"exposure_us": 60.0}, ("camera 1, row 3: the station states 60.0 µs of light, it was 250.0 µs",)),
        ({"exposure_us": None}, ("camera 1, row 3: the station states None µs of light, it was 250.0 µs",)),
        ({"light": "left", "verdict": "missing"}, ()),
    ],
)
def test_a_light_that_the_chip_did_not_fire_is_reported(
    known: RenderedBoard, stated: dict[str, Any], words: tuple[str, ...]
) -> None:
    run = run_json(known)
    for frame in run["frames"]:
        frame.update(stated if (frame["camera"], frame["row"]) == (1, 3) else {})
    lighting = Lighting({"left": (1,), "ring": (0,)}, (300.0,) * CAMERAS)
    board = score(replace(evidence_of(known), run=run, lighting=lighting), ())
    assert board.mislit == words
    assert board.sound == (not words and "verdict" not in stated)


def test_pixels_that_were_overwritten_meanwhile_prove_nothing(known: RenderedBoard) -> None:
    evidence = evidence_of(known)
    assert evidence.ring_check is not None
    assert score(replace(evidence, ring_check=replace(evidence.ring_check, valid=False)), ()).proven is None
    assert score(replace(evidence, ring_check=None), ()).proven is None


def test_an_outage_excuses_its_own_camera_and_time(known: RenderedBoard) -> None:
    lost = {(0, 2): ("missing", "gone"), (0, 5): ("missing", "gone"), (1, 2): ("missing", "gone")}
    outage = Outage(2 * PERIOD_NS, 3 * PERIOD_NS, 0, "the camera was dead")
    board = scored(known, None, lost, outages=(outage,))
    assert board.innocent == ((0, 5), (1, 2))
    everywhere = replace(outage, camera=None, until_ns=9 * PERIOD_NS)
    assert scored(known, None, lost, outages=(everywhere,)).innocent == ()


def test_an_unarmed_camera_is_excused_only_by_an_outage(known: RenderedBoard) -> None:
    lost = {(0, 2): ("missing", "gone")}
    outage = Outage(0, 9 * PERIOD_NS, None, "the controller was reset")
    assert scored(known, {(0, 2): "unarmed"}, lost).innocent == ((0, 2),)
    [frame] = scored(known, {(0, 2): "unarmed"}, lost, outages=(outage,)).affected
    assert frame.done == "the controller was reset, and the camera was not armed"


@given(st.integers(0, 10**10), st.integers(0, 10**9), st.integers(0, 12 * 10**9))
def test_an_outage_covers_its_time_and_the_frames_in_flight(from_ns: int, lasts_ns: int, fired_ns: int) -> None:
    outage = Outage(from_ns, from_ns + lasts_ns, 3, "")
    inside = from_ns - IN_FLIGHT_S * 1e9 <= fired_ns <= from_ns + lasts_ns
    assert outage.covers(fired_ns, 3) == inside
    assert not outage.covers(fired_ns, 4)
    assert replace(outage, camera=None).covers(fired_ns, 4) == inside


def test_a_board_without_a_run(known: RenderedBoard) -> None:
    board = score(BoardEvidence(passage_of(known), None, {}, None, [18.0, 18.0]), ())
    assert (board.run, board.state, board.status, board.unfilmed) == (None, None, None, CAMERAS * ROWS)
    assert (board.ok, board.proven, board.deviation.views) == (0, None, 0)


def test_frames_that_the_run_does_not_list_are_counted(known: RenderedBoard) -> None:
    run = run_json(known)
    run["frames"] = [frame for frame in run["frames"] if frame["row"] < 4]
    assert score(replace(evidence_of(known), run=run), ()).unfilmed == 2 * CAMERAS


def test_figures_of_the_stitch_are_taken_from_the_run(known: RenderedBoard) -> None:
    timings = {"ready_after_last_frame_ms": 180.5, "links": 20, "links_while_filming": 15}
    reasons = [{"message": "Camera 0 lost a frame."}]
    run = run_json(known) | {"timings": timings, "reasons": reasons, "verdict": "degraded"}
    board = score(replace(evidence_of(known), run=run), ())
    assert (board.ready_after_last_frame_ms, board.links_open) == (180.5, 5)
    assert (board.status, board.reasons) == ("degraded", ("Camera 0 lost a frame.",))


def test_notes_of_equal_pulses_appear_once(known: RenderedBoard) -> None:
    evidence = evidence_of(known)
    for fired in evidence.passage.fired[2:4]:
        fired.note = "LED channels (1,) were lit, not those of 'ring'"
    board = score(evidence, ())
    assert board.notes == ("LED channels (1,) were lit, not those of 'ring'",)
    assert not board.sound


def test_the_run_of_a_passage_is_the_one_with_its_barrier_edge(known: RenderedBoard) -> None:
    passage = passage_of(known)
    runs = [{"id": "before"}, {"id": "its"}]
    assert run_of(passage, runs, {"before": 2.0, "its": 5.01}) == "its"
    assert run_of(passage, runs, {"before": 2.0, "its": 5.01 + RUN_MATCH_S}) is None
    assert run_of(passage, [], {}) is None
