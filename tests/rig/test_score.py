"""The score of a board."""

from __future__ import annotations

from collections.abc import Iterator
from dataclasses import replace
from pathlib import Path
from typing import Any

import numpy as np
import pytest

from tests.rig.known_boards import CAMERAS, PERIOD_NS, ROWS, evidence_of, passage_of, run_json, scored
from vaoi_station.acquisition.ring import INCOMPLETE, OK, FrameShape, Ring, RingLayout
from vaoi_station.rig.chip import Pulse
from vaoi_station.rig.devices import Outage
from vaoi_station.rig.line import BoardPassage, FiredPulse, FrameOutcome, Lighting
from vaoi_station.rig.rendering import RenderedBoard
from vaoi_station.rig.report import BoardScore
from vaoi_station.rig.score import (
    MONO_8,
    RUN_MATCH_S,
    RingCheck,
    check_bay,
    run_of,
    score,
)
from vaoi_station.rig.virtual_camera import apply_brightness

BAY = 1


@pytest.fixture
def passage(boards: tuple[RenderedBoard, ...]) -> BoardPassage:
    """A board of which row 2 was lit half."""
    rendered = boards[0]
    lights = [0.5 if row == 2 else 1.0 for row in range(rendered.rows)]
    fired = [
        FiredPulse(row, Pulse(row, row, (0,), 250.0), 0.0, ["sent"] * 2, [lights[row]] * 2)
        for row in range(rendered.rows)
    ]
    return BoardPassage(0, rendered, 0, 0, fired)


@pytest.fixture
def ring(passage: BoardPassage, tmp_path: Path) -> Iterator[Ring]:
    """It holds the board as it was boards."""
    layout = RingLayout(2, passage.rendered.rows + 2, (FrameShape(640, 480, "Mono8"),) * 2)
    with Ring.create(tmp_path / "test.ring", layout) as ring:
        ring.claim(BAY)
        for row, cameras in enumerate(passage.rendered.map_frames()):
            for camera, frame in enumerate(cameras):
                put(ring, camera, row, apply_brightness(frame, passage.fired[row].brightness[camera], MONO_8))
        yield ring


def put(ring: Ring, camera: int, row: int, pixels: np.ndarray, state: int = OK, k: int | None = None) -> None:
    slot = ring.slot(BAY, camera, row + 1 if k is None else k)
    ring.memory(slot)[:] = pixels
    ring.write_slot_record(slot, state, row, 65400 + row)


def look(ring: Ring, passage: BoardPassage) -> RingCheck:
    check = check_bay(ring, BAY, passage)
    assert check is not None
    return check


def test_frames_that_have_changed_places_are_named(ring: Ring, passage: BoardPassage) -> None:
    frames = passage.rendered.map_frames()
    put(ring, 0, 3, frames[4, 0])
    put(ring, 1, 5, frames[5, 0])
    put(ring, 1, 1, frames[1, 1] ^ 1)
    assert look(ring, passage).wrong == {
        (0, 3): "it is the frame of camera 0, row 4",
        (1, 5): "it is the frame of camera 0, row 5",
        (1, 1): "it is no frame of this board as camera 1 saw it in row 1",
    }


def test_half_a_frame_is_a_half_of_its_own_frame(ring: Ring, passage: BoardPassage) -> None:
    frames = passage.rendered.map_frames()
    half = frames[3, 0].copy()
    half[half.size // 2 :] = 0
    put(ring, 0, 3, half, INCOMPLETE)
    foreign = frames[3, 1].copy()
    foreign[:1000] = 0
    foreign[-5:] = np.where(frames[3, 1][-5:] == 200, 100, 200)
    put(ring, 1, 3, foreign, INCOMPLETE)
    seen = look(ring, passage)
    assert (0, 3) not in seen.proven
    assert seen.wrong == {(1, 3): "5 pixels of another picture"}


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


def test_a_frame_that_the_rig_sent_late_is_the_rigs(known: RenderedBoard) -> None:
    lost = {(0, 5): ("missing", "no frame came")}
    evidence = evidence_of(known, None, lost)
    evidence.passage.fired[5].sent_ms[0] = 700.0
    board = score(evidence, ())
    assert board.sent_late_ms == 700.0
    assert board.affected[0].done == "the rig sent it 700 ms late"
    del evidence.passage.fired[5].sent_ms[0]
    never = score(evidence, ())
    assert (never.sent_late_ms, never.affected[0].done) == (None, "the rig never sent it")


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


def innocent(board: BoardScore) -> list[tuple[int, int]]:
    return [(frame.camera, frame.row) for frame in board.affected if not frame.done]


def test_an_unarmed_camera_is_excused_only_by_an_outage(known: RenderedBoard) -> None:
    lost = {(0, 2): ("missing", "gone")}
    outage = Outage(0, 9 * PERIOD_NS, None, "the controller was reset")
    assert innocent(scored(known, {(0, 2): "unarmed"}, lost)) == [(0, 2)]
    [frame] = scored(known, {(0, 2): "unarmed"}, lost, outages=(outage,)).affected
    assert frame.done == "the controller was reset, and the camera was not armed"


def test_the_run_of_a_passage_is_the_one_with_its_barrier_edge(known: RenderedBoard) -> None:
    passage = passage_of(known)
    runs = [{"id": "before"}, {"id": "its"}]
    assert run_of(passage, runs, {"before": 2.0, "its": 5.01}) == "its"
    assert run_of(passage, runs, {"before": 2.0, "its": 5.01 + RUN_MATCH_S}) is None
    assert run_of(passage, [], {}) is None
