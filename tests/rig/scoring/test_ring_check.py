"""The ring after a run, pixel by pixel."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from vaoi_station.acquisition.ring import INCOMPLETE, OK, FrameShape, Ring, RingLayout
from vaoi_station.rig.chip import Pulse
from vaoi_station.rig.line import BoardPassage, FiredPulse
from vaoi_station.rig.rendering import RenderedBoard
from vaoi_station.rig.score import MONO_8, RingCheck, bays_to_check, check_bay
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
    return check_bay(ring, BAY, passage)


def test_all_frames_are_in_their_rows(ring: Ring, passage: BoardPassage) -> None:
    seen = look(ring, passage)
    assert len(seen.proven) == 2 * passage.rendered.rows
    assert (seen.partial, seen.wrong, seen.valid) == (frozenset(), {}, True)


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
    assert seen.partial == {(0, 3)}
    assert seen.wrong == {(1, 3): "5 pixels of another picture"}


def test_only_runs_that_are_filmed_are_checked() -> None:
    uses = [("finished", "r1"), ("stitching", "r2"), ("filming", "r3"), ("granted", "r4")]
    bays = [{"bay": n, "use": use, "run": run} for n, (use, run) in enumerate(uses)] + [{"bay": 4, "use": "free"}]
    assert bays_to_check({"ring": {"bays": bays}}) == {"r1": 0, "r2": 1}


def test_a_row_that_was_never_fired_is_wrong(ring: Ring, passage: BoardPassage) -> None:
    put(ring, 0, 99, passage.rendered.map_frames()[0, 0], k=0)
    assert look(ring, passage).wrong == {(0, 99): "a row that was never fired"}
