"""Cameras and controller of the benchmark, with a scripted sender at the other end of the pipe."""

from __future__ import annotations

import multiprocessing
from collections.abc import Iterator
from multiprocessing.connection import Connection
from queue import SimpleQueue
from typing import TYPE_CHECKING, Any, cast

import numpy as np
import pytest

from vaoi_station.acquisition.cameras.interface import Arrival, CameraEvent, Slot
from vaoi_station.acquisition.controller.interface import EventQueue, PulseFired, RunEnded, TriggerPlan
from vaoi_station.acquisition.device_clock import DeviceClock
from vaoi_station.benchmarks.station.frame_sender import FillRequest
from vaoi_station.benchmarks.station.prerendered_run import PrerenderedRun
from vaoi_station.benchmarks.station.sender_devices import Playback, SenderCamera, SenderConnection, sender_devices
from vaoi_station.config import StationConfig

if TYPE_CHECKING:
    Pipe = Connection[Any, Any]

TIMEOUT_S = 20.0


@pytest.fixture
def pipe() -> Iterator[tuple[Pipe, Pipe]]:
    """Return the end of the devices and that of the sender."""
    here, there = multiprocessing.Pipe()
    yield here, there
    there.close()


@pytest.fixture
def arrivals() -> SimpleQueue[CameraEvent]:
    return SimpleQueue()


def slot(number: int) -> Slot:
    return Slot(number, np.zeros(4, np.uint8))


def test_frame_arrives_when_the_sender_returns_its_request(
    pipe: tuple[Pipe, Pipe], arrivals: SimpleQueue[CameraEvent]
) -> None:
    camera = SenderCamera(3, DeviceClock(), SenderConnection(pipe[0]))
    camera.start(arrivals)
    camera.queue(slot(17))
    camera.trigger(5, 1.25)
    request = pipe[1].recv()
    assert request == FillRequest(camera=3, row=5, slot=17)
    assert arrivals.empty()
    pipe[1].send(request)
    arrival = arrivals.get(timeout=TIMEOUT_S)
    assert isinstance(arrival, Arrival)
    assert (arrival.camera, arrival.slot, arrival.complete) == (3, 17, True)
    assert (arrival.frame_id, arrival.time_s) == (1, 1.25)
    assert camera.health().delivered == 1


def test_cameras_of_one_connection_share_one_queue(pipe: tuple[Pipe, Pipe], arrivals: SimpleQueue[CameraEvent]) -> None:
    connection = SenderConnection(pipe[0])
    cameras = [SenderCamera(n, DeviceClock(), connection) for n in range(2)]
    for camera in cameras:
        camera.start(arrivals)
        camera.queue(slot(camera.number))
        camera.trigger(0, 0.0)
    # The sender may return requests in any order.
    for request in reversed([pipe[1].recv() for _ in cameras]):
        pipe[1].send(request)
    seen = [arrivals.get(timeout=TIMEOUT_S) for _ in cameras]
    assert [a.camera for a in seen if isinstance(a, Arrival)] == [1, 0]


def test_frame_without_a_slot_is_dropped_and_leaves_a_gap_in_the_ids(
    pipe: tuple[Pipe, Pipe], arrivals: SimpleQueue[CameraEvent]
) -> None:
    camera = SenderCamera(0, DeviceClock(), SenderConnection(pipe[0]))
    camera.start(arrivals)
    camera.trigger(0, 0.0)
    camera.queue(slot(1))
    camera.trigger(1, 0.1)
    pipe[1].send(pipe[1].recv())
    arrival = arrivals.get(timeout=TIMEOUT_S)
    assert isinstance(arrival, Arrival)
    assert arrival.frame_id == 2
    health = camera.health()
    assert (health.delivered, health.message) == (1, "1 frames found no free slot")


def test_unused_slots_are_given_back_once(pipe: tuple[Pipe, Pipe]) -> None:
    camera = SenderCamera(0, DeviceClock(), SenderConnection(pipe[0]))
    for number in (4, 2, 9):
        camera.queue(slot(number))
    assert camera.take_back() == [4, 2, 9]
    assert camera.take_back() == []
    camera.close()


def test_controller_repeats_the_run_at_the_requested_rate(pipe: tuple[Pipe, Pipe], small_run: PrerenderedRun) -> None:
    rate, rows = 8.0, small_run.head.rows
    devices = sender_devices(Playback(small_run, rate, 0.0), pipe[0], cast("StationConfig", None))
    arrivals: SimpleQueue[CameraEvent] = SimpleQueue()
    for n, camera in enumerate(devices.cameras):
        camera.start(arrivals)
        for k in range(2 * rows):
            camera.queue(slot(100 * n + k))
    events: EventQueue = SimpleQueue()
    devices.controller.start(events)
    devices.controller.arm(TriggerPlan(0.01, 0.02, 0.01, rows, 0.005))
    seen: list[object] = []
    try:
        while sum(isinstance(e, RunEnded) for e in seen) < 2:
            seen.append(events.get(timeout=TIMEOUT_S))
    finally:
        devices.controller.close()
    requests = []
    while pipe[1].poll():
        requests.append(pipe[1].recv())
    assert [(r.row, r.camera) for r in requests[: 4 * rows]] == [(j, i) for j in range(rows) for i in (0, 1)] * 2
    times_s = np.array([e.time_s for e in seen if isinstance(e, PulseFired)])
    expected_s = small_run.head.row_times_s() / rate
    for run in (times_s[:rows], times_s[rows : 2 * rows]):
        assert run - run[0] == pytest.approx(expected_s - expected_s[0], abs=1e-6)
