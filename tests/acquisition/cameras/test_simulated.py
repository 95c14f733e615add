"""Tests of the simulated camera: time stamps, frame ids, and the faults that it applies."""

from __future__ import annotations

import time
from collections.abc import Iterator
from queue import Empty, SimpleQueue
from typing import Any

import numpy as np
import pytest

from vaoi_station.acquisition.cameras.interface import Slot
from vaoi_station.acquisition.clocks import DeviceClock
from vaoi_station.acquisition.pairing.evidence import MAX_FRAME_ID
from vaoi_station.acquisition.simulated import FIRST_ID, JITTER_S, READOUT_S, TRANSFER_S, SimulatedCamera

PIXELS = np.full(64, 200, np.uint8)
CLOCK = DeviceClock(offset_s=3600.0, drift_ppm=40.0)
TIMEOUT_S = 10.0


@pytest.fixture
def arrivals() -> SimpleQueue[Any]:
    return SimpleQueue()


@pytest.fixture
def camera(arrivals: SimpleQueue[Any]) -> Iterator[SimulatedCamera]:
    """Start a camera with 40 empty slots."""
    camera = SimulatedCamera(1, CLOCK, exposure_us=500.0)
    for number in range(40):
        camera.queue(Slot(number, np.zeros(64, np.uint8)))
    camera.start(arrivals)
    yield camera
    camera.close()


def past_s() -> float:
    """Return a pulse time whose transfer is over already, so that its frame arrives at once."""
    return time.monotonic() - 1.0


def test_the_time_stamp_is_the_pulse_on_the_cameras_clock(camera: SimulatedCamera, arrivals: SimpleQueue[Any]) -> None:
    host_s = past_s()
    camera.trigger(host_s, PIXELS)
    arrival = arrivals.get(timeout=TIMEOUT_S)
    assert arrival.complete
    assert 0 <= arrival.time_s - CLOCK.device_s(host_s) < 10e-6


def test_a_frame_arrives_after_exposure_read_out_and_transfer(
    camera: SimulatedCamera, arrivals: SimpleQueue[Any]
) -> None:
    host_s = time.monotonic()
    camera.trigger(host_s, PIXELS)
    arrival = arrivals.get(timeout=TIMEOUT_S)
    assert arrival.host_time_s - host_s >= 500e-6 + READOUT_S + TRANSFER_S


def test_ids_wrap_to_1_and_a_lost_frame_is_counted(camera: SimulatedCamera, arrivals: SimpleQueue[Any]) -> None:
    count = MAX_FRAME_ID - FIRST_ID + 3
    start_s = past_s()
    for n in range(count):
        camera.trigger(start_s + n * (JITTER_S + 1e-3), PIXELS, lost=n == 2)
    ids = [arrivals.get(timeout=TIMEOUT_S).frame_id for _ in range(count - 1)]
    expected = [FIRST_ID + n for n in range(MAX_FRAME_ID - FIRST_ID + 1) if n != 2] + [1, 2]
    assert ids == expected
    with pytest.raises(Empty):
        arrivals.get_nowait()


def test_an_exchanged_frame_has_another_time_stamp_and_id(camera: SimulatedCamera, arrivals: SimpleQueue[Any]) -> None:
    host_s = past_s()
    camera.trigger(host_s, PIXELS, stamp_error_s=0.1, id_error=1)
    arrival = arrivals.get(timeout=TIMEOUT_S)
    assert arrival.frame_id == FIRST_ID + 1
    assert arrival.time_s - CLOCK.device_s(host_s + 0.1) == pytest.approx(0.0, abs=10e-6)
    camera.trigger(host_s, PIXELS)
    assert arrivals.get(timeout=TIMEOUT_S).frame_id == FIRST_ID + 1, "the counter itself is not changed"


def test_a_share_of_a_frame_is_incomplete(camera: SimulatedCamera, arrivals: SimpleQueue[Any]) -> None:
    camera.trigger(past_s(), PIXELS, share=0.25)
    arrival = arrivals.get(timeout=TIMEOUT_S)
    assert (arrival.complete, arrival.frame_id, arrival.time_s) == (False, None, None)
    assert "25%" in arrival.fault


def test_a_late_frame_is_delayed(camera: SimulatedCamera, arrivals: SimpleQueue[Any]) -> None:
    host_s = time.monotonic()
    camera.trigger(host_s, PIXELS, late_s=0.05)
    assert arrivals.get(timeout=TIMEOUT_S).host_time_s - host_s >= 0.05 + READOUT_S + TRANSFER_S
