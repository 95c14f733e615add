"""Clock readings: which registers are read, their unit, and the bound of a reading."""

from __future__ import annotations

import time

import pytest

from tests.acquisition.cameras.aravis.stand_in import StandInCamera
from vaoi_station.acquisition.cameras.aravis.connection import FAKE_VENDOR, find_clock
from vaoi_station.acquisition.clocks import timed_reading
from vaoi_station.errors import DeviceError


def test_a_reading_lies_between_request_and_reply() -> None:
    moments: list[float] = []

    def read_s() -> float:
        moments.append(time.monotonic())
        return 3.0

    before_s = time.monotonic()
    reading = timed_reading(read_s)
    after_s = time.monotonic()
    assert reading.device_s == 3.0
    assert abs(moments[0] - reading.host_s) <= reading.bound_s + 1e-9
    assert 0 <= reading.bound_s <= (after_s - before_s) / 2 + 1e-9


def test_the_time_is_latched_before_it_is_read() -> None:
    camera = StandInCamera()
    read_ns, is_remote = find_clock(camera, "camera c0")
    assert is_remote
    assert read_ns() == 5_000_000_000
    assert camera.device.commands == ["TimestampLatch"]


@pytest.mark.parametrize(("hertz", "wanted_ns"), [(125_000_000, 8_000), (1_000_000_000, 1_000), (0, 1_000)])
def test_ticks_of_gige_vision_1_are_converted(hertz: int, wanted_ns: int) -> None:
    camera = StandInCamera()
    del camera.device.features["TimestampLatch"]
    camera.device.features |= {"GevTimestampControlLatch": 0, "GevTimestampValue": 1_000}
    camera.device.tick_hz = hertz
    assert find_clock(camera, "camera c0")[0]() == wanted_ns


def test_the_fake_camera_has_the_wall_clock_of_this_computer() -> None:
    camera = StandInCamera(FAKE_VENDOR)
    del camera.device.features["TimestampLatch"]
    read_ns, is_remote = find_clock(camera, "camera c0")
    assert not is_remote
    before_ns = time.time_ns()
    assert before_ns <= read_ns() <= time.time_ns()


def test_a_camera_without_a_latch_is_refused() -> None:
    camera = StandInCamera()
    del camera.device.features["TimestampLatchValue"]
    with pytest.raises(DeviceError, match="camera c0: has no time stamp that can be latched") as refused:
        find_clock(camera, "camera c0")
    assert refused.value.code == "clock-unknown"
