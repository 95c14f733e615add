"""A frame that Aravis calls complete is complete only with its size, its format, all its bytes, and no packet twice."""

from __future__ import annotations

import time
from typing import Any

import pytest

from tests.acquisition.cameras.aravis.stand_in import BufferStatus, StandInBuffer, StandInStream
from vaoi_station.acquisition.cameras.aravis.stream import FrameCheck, FrameFormat
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


def test_a_stream_that_counts_no_duplicates_is_checked_otherwise() -> None:
    stream = StandInStream()
    del stream.counters["n_duplicated_packets"]
    assert FrameCheck(stream, KIND).fault(frame(), 256) == ""
