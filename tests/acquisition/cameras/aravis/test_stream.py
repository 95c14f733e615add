"""Frames in slots: what is complete, what is reported, what is taken back."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from queue import SimpleQueue
from typing import Any

import numpy as np
import pytest

from tests.acquisition.cameras.aravis.stand_in import BufferStatus, StandInBuffer, StandInStream
from vaoi_station.acquisition.cameras.aravis import stream as stream_module
from vaoi_station.acquisition.cameras.aravis.stream import FrameCheck, FrameFormat, SlotResult, SlotStream
from vaoi_station.acquisition.cameras.interface import Slot
from vaoi_station.pixel_formats import PIXEL_FORMATS

pytestmark = pytest.mark.usefixtures("_stand_in")

KIND = FrameFormat(16, 16, PIXEL_FORMATS["Mono8"].code)


def frame(status: BufferStatus = BufferStatus.SUCCESS, **changes: Any) -> StandInBuffer:
    buffer = StandInBuffer(256, 0)
    buffer.status = status
    vars(buffer.frame).update(changes)
    return buffer


@pytest.mark.parametrize(
    ("changes", "fault"),
    [
        ({}, ""),
        ({"status": BufferStatus.MISSING_PACKETS}, "packets of the frame were lost on the way"),
        ({"status": BufferStatus.NEW_ONE}, "Aravis calls the frame 'new-one'"),
        ({"width": 8}, "the frame is 8×16 px in format 0x01080001, not 16×16 px in format 0x01080001"),
        ({"received": 200}, "200 of its 256 bytes arrived although it ended"),
        ({"received": 300}, "300 of its 256 bytes arrived although it ended"),
        ({"chunks": True}, "its ChunkModeActive was switched on"),
    ],
)
def test_success_is_not_enough(changes: dict[str, Any], fault: str) -> None:
    found = FrameCheck(StandInStream(), KIND).fault(frame(**changes), 256)
    assert (fault in found) if fault else found == ""


def test_frames_that_had_begun_when_a_packet_came_twice_are_suspect(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = StandInStream()
    check = FrameCheck(stream, KIND)
    monkeypatch.setattr(time, "time_ns", lambda: 5_000)
    stream.counters["n_duplicated_packets"] = 1
    assert "a packet came twice" in check.fault(frame(began_ns=3_000), 256)
    assert "a packet came twice" in check.fault(frame(began_ns=4_000), 256), "received meanwhile, read afterwards"
    assert check.fault(frame(began_ns=6_000), 256) == ""


def test_packets_that_were_asked_for_again_may_come_twice(monkeypatch: pytest.MonkeyPatch) -> None:
    stream = StandInStream()
    monkeypatch.setattr(time, "time_ns", lambda: 5_000)
    stream.counters |= {"n_resend_requests": 3, "n_duplicated_packets": 0}
    careless, strict = FrameCheck(stream, KIND), FrameCheck(stream, KIND, misnumbers=True)
    assert careless.fault(frame(began_ns=1_000), 256) == ""
    stream.counters["n_duplicated_packets"] = 2
    assert careless.fault(frame(began_ns=2_000), 256) == "", "asked for while the frame before was received"
    assert "a packet came twice" in strict.fault(frame(began_ns=2_000), 256)
    assert careless.fault(frame(began_ns=3_000), 256) == ""
    stream.counters["n_duplicated_packets"] = 3
    assert "a packet came twice" in careless.fault(frame(began_ns=4_000), 256), "it was not asked for"


def test_a_clock_that_was_set_back_makes_no_later_frame_suspect(monkeypatch: pytest.MonkeyPatch) -> None:
    """As by NTP some time after the start: all frames of an hour would be suspect."""
    now = [5_000_000]
    stream = StandInStream()
    check = FrameCheck(stream, KIND)
    monkeypatch.setattr(time, "time_ns", lambda: now[0])
    stream.counters["n_duplicated_packets"] = 1
    assert "a packet came twice" in check.fault(frame(began_ns=4_999_000), 256)
    now[0] = 1_000_000
    check.fault(frame(began_ns=999_000), 256)
    for began_ns in (1_001_000, 2_000_000):
        now[0] = began_ns + 1_000
        assert check.fault(frame(began_ns=began_ns), 256) == ""


MEMORY = np.zeros((4, 256), np.uint8)
SLOTS = [Slot(number, MEMORY[number]) for number in range(4)]


class Bench:
    """A stream of slots over a stand-in, and the slots that were reported."""

    def __init__(self) -> None:
        self.aravis_stream = StandInStream()
        self.results: SimpleQueue[SlotResult] = SimpleQueue()
        kind = FrameFormat(16, 16, PIXEL_FORMATS["Mono8"].code)
        self.slots = SlotStream(self.aravis_stream, kind, self.results.put, "test")

    def fill(self, status: BufferStatus = BufferStatus.SUCCESS, k: int = 0, **frame: int) -> SlotResult:
        """End a frame in the k-th buffer that was pushed, and return what is reported."""
        buffer = self.aravis_stream.pushed[k]
        buffer.status = status
        vars(buffer.frame).update(frame)
        self.aravis_stream.filled.append(buffer)
        return self.results.get(timeout=10)


@pytest.fixture
def bench(_stand_in: None) -> Iterator[Bench]:
    bench = Bench()
    yield bench
    bench.slots.close()


def test_a_frame_under_way_gets_time_to_end(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream_module, "FILLING_S", 10.0)
    bench.slots.queue(SLOTS[0])
    buffer = bench.aravis_stream.pushed[0]
    buffer.status = BufferStatus.FILLING
    waiting = threading.Event()
    real_status = buffer.get_status

    def get_status() -> BufferStatus:
        waiting.set()
        return real_status()

    buffer.get_status = get_status  # type: ignore[method-assign]

    def end_the_frame() -> None:
        waiting.wait(10)
        buffer.status = BufferStatus.SUCCESS
        bench.aravis_stream.filled.append(buffer)

    ending = threading.Thread(target=end_the_frame)
    ending.start()
    assert bench.slots.take_back() == []
    ending.join()
    assert bench.results.get(timeout=10).whole


def test_a_frame_that_does_not_end_is_broken_off(bench: Bench, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(stream_module, "FILLING_S", 0.0)
    for slot in SLOTS[:2]:
        bench.slots.queue(slot)
    bench.aravis_stream.pushed[0].status = BufferStatus.FILLING
    assert bench.slots.take_back() == [SLOTS[1]]
    result = bench.results.get(timeout=10)
    assert (result.slot, result.whole) == (SLOTS[0], False)
    assert "broken off" in result.fault
