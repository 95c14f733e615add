"""Tests of the replay camera: recorded time stamps, and an id for every row."""

from __future__ import annotations

from queue import Empty, SimpleQueue
from typing import Any

import numpy as np
import pytest

from vaoi_station.acquisition.cameras.interface import Slot
from vaoi_station.acquisition.clocks import DeviceClock
from vaoi_station.acquisition.replay import ReplayCamera

TIMEOUT_S = 10.0


def test_frames_have_the_recorded_times_and_missing_ones_use_an_id() -> None:
    arrivals: SimpleQueue[Any] = SimpleQueue()
    camera = ReplayCamera(1, DeviceClock(5.0))
    slots = [Slot(n, np.zeros(8, np.uint8)) for n in range(3)]
    for slot in slots:
        camera.queue(slot)
    camera.start(arrivals)
    try:
        camera.play(10.0, np.full(8, 1, np.uint8))
        camera.play(10.1, None)
        camera.play(10.2, np.full(8, 3, np.uint8))
        found = [arrivals.get(timeout=TIMEOUT_S) for _ in range(2)]
        with pytest.raises(Empty):
            arrivals.get_nowait()
    finally:
        camera.close()
    assert [(a.camera, a.slot, a.frame_id, a.time_s) for a in found] == [(1, 0, 1, 10.0), (1, 1, 3, 10.2)]
    assert [slot.memory[0] for slot in slots] == [1, 3, 0]


def test_its_clock_is_read_without_error() -> None:
    clock = DeviceClock(5.0)
    reading = ReplayCamera(0, clock).read_clock()
    assert reading.bound_s == 0.0
    assert clock.device_s(reading.host_s) == reading.device_s
