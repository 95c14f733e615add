"""Tests of the camera interface: every backend without hardware has its methods with the same parameters."""

from __future__ import annotations

import inspect

import numpy as np
import pytest

from vaoi_station.acquisition.cameras.interface import CameraDevice, CameraHealth, Slot, is_silent
from vaoi_station.acquisition.clocks import DeviceClock
from vaoi_station.acquisition.replay import ReplayCamera
from vaoi_station.acquisition.simulated import SimulatedCamera

METHODS = [name for name, _ in inspect.getmembers(CameraDevice, inspect.isfunction) if not name.startswith("_")]


def make(backend: type) -> CameraDevice:
    camera: CameraDevice = backend(0, DeviceClock(), 100.0) if backend is SimulatedCamera else backend(0, DeviceClock())
    return camera


@pytest.mark.parametrize("backend", [SimulatedCamera, ReplayCamera])
def test_a_camera_holds_queued_slots_until_they_are_withdrawn(backend: type) -> None:
    camera = make(backend)
    for number in (4, 7):
        camera.queue(Slot(number, np.zeros(4, np.uint8)))
    assert camera.take_back() == [4, 7]
    assert camera.take_back() == []
    assert camera.health() == CameraHealth(True)
    camera.close()


@pytest.mark.parametrize(
    ("health", "silent"),
    [
        (CameraHealth(True, counters=(("n_received_packets", 0),)), True),
        (CameraHealth(True, counters=(("n_received_packets", 1),)), False),
        (CameraHealth(False, counters=(("n_received_packets", 0),)), False),
        (CameraHealth(True), False),
    ],
)
def test_only_a_connected_camera_that_counts_packets_can_be_silent(health: CameraHealth, silent: bool) -> None:
    assert is_silent(health) is silent
