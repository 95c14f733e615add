"""Tests of the virtual camera: slots in order, nothing without a slot, nothing after closing."""

from __future__ import annotations

import time
from collections.abc import Iterator
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np
import pytest

from vaoi_station.acquisition.cameras.interface import Arrival, Slot
from vaoi_station.acquisition.cameras.virtual import Exposure, VirtualCamera
from vaoi_station.acquisition.clocks import DeviceClock

PIXELS = np.arange(1, 101, dtype=np.uint8)


@pytest.fixture
def arrivals() -> SimpleQueue[Any]:
    return SimpleQueue()


@pytest.fixture
def camera(arrivals: SimpleQueue[Any]) -> Iterator[VirtualCamera]:
    camera = VirtualCamera(3, DeviceClock().read)
    camera.start(arrivals)
    yield camera
    camera.close()


def slot(number: int) -> Slot:
    return Slot(number, np.zeros(100, np.uint8))


def exposure(frame_id: int, after_s: float = 0.0, lasting_s: float = 0.0, share: float = 1.0) -> Exposure:
    begin_s = time.monotonic() + after_s
    return Exposure(frame_id, float(frame_id), begin_s, begin_s + lasting_s, PIXELS, share)


def test_frames_fill_slots_in_the_order_they_were_queued(camera: VirtualCamera, arrivals: SimpleQueue[Any]) -> None:
    slots = [slot(7), slot(8)]
    for s in slots:
        camera.queue(s)
    camera.expose(exposure(2, after_s=0.03))
    camera.expose(exposure(1))
    first, second = (arrivals.get(timeout=10) for _ in range(2))
    assert [(a.slot, a.frame_id, a.complete) for a in (first, second)] == [(7, 1, True), (8, 2, True)]
    assert isinstance(first, Arrival)
    assert (first.camera, first.time_s) == (3, 1.0)
    assert (slots[0].memory == PIXELS).all()
    assert camera.health().delivered == 2


def test_an_incomplete_frame_has_neither_id_nor_time_stamp(camera: VirtualCamera, arrivals: SimpleQueue[Any]) -> None:
    half = slot(1)
    camera.queue(half)
    camera.expose(exposure(5, share=0.5))
    arrival = arrivals.get(timeout=10)
    assert (arrival.complete, arrival.frame_id, arrival.time_s) == (False, None, None)
    assert "50%" in arrival.fault
    assert (half.memory[:50] == PIXELS[:50]).all()
    assert not half.memory[50:].any()
    assert camera.health().incomplete == 1


def test_a_frame_without_a_slot_is_dropped_and_counted(camera: VirtualCamera, arrivals: SimpleQueue[Any]) -> None:
    camera.queue(slot(1))
    assert camera.take_back() == [1]
    camera.expose(exposure(1))
    camera.expose(exposure(2, after_s=0.02))
    deadline_s = time.monotonic() + 10
    while camera.health().message != "2 frames dropped: no free slot in the ring":
        assert time.monotonic() < deadline_s
        with pytest.raises(Empty):
            arrivals.get(timeout=0.01)


def test_closing_ends_a_transfer_under_way(arrivals: SimpleQueue[Any]) -> None:
    camera = VirtualCamera(0, DeviceClock().read)
    camera.start(arrivals)
    camera.queue(slot(1))
    camera.expose(exposure(1, lasting_s=100.0))
    camera.expose(exposure(2, after_s=100.0))
    camera.close()
    assert arrivals.empty()
    assert not camera.health().connected
