"""Clock readings: which registers are read, their unit, and the bound of a reading."""

from __future__ import annotations

import time

import pytest

from tests.acquisition.cameras.aravis.stand_in import StandInCamera
from vaoi_station.acquisition.cameras.aravis.clock import FAKE_VENDOR, CameraClock, find_clock
from vaoi_station.errors import DeviceError


def test_a_reading_lies_between_request_and_reply() -> None:
    moments: list[float] = []

    def read_ns() -> int:
        moments.append(time.monotonic())
        return 5_000_000_000

    before_s = time.monotonic()
    reading = CameraClock(read_ns).read(epoch_ns=2_000_000_000)
    after_s = time.monotonic()
    assert reading.device_s == 3.0
    assert abs(moments[0] - reading.host_s) <= reading.bound_s + 1e-9
    assert 0 <= reading.bound_s <= (after_s - before_s) / 2 + 1e-9


def test_seconds_since_a_late_epoch_are_exact_to_the_nanosecond() -> None:
    epoch_ns = 1_700_000_000_123_456_789
    reading = CameraClock(lambda: epoch_ns + 1).read(epoch_ns)
    assert reading.device_s == 1e-9


def test_the_time_is_latched_before_it_is_read() -> None:
    camera = StandInCamera()
    clock = find_clock(camera, "camera c0")
    assert clock.remote
    assert clock.read_ns() == 5_000_000_000
    assert camera.device.commands == ["TimestampLatch"]


@pytest.mark.parametrize(("hertz", "wanted_ns"), [(125_000_000, 8_000), (1_000_000_000, 1_000), (0, 1_000)])
def test_ticks_of_gige_vision_1_are_converted(hertz: int, wanted_ns: int) -> None:
    camera = StandInCamera()
    del camera.device.features["TimestampLatch"]
    camera.device.features |= {"GevTimestampControlLatch": 0, "GevTimestampValue": 1_000}
    camera.device.tick_hz = hertz
    assert find_clock(camera, "camera c0").read_ns() == wanted_ns


def test_the_fake_camera_has_the_wall_clock_of_this_computer() -> None:
    camera = StandInCamera(FAKE_VENDOR)
    del camera.device.features["TimestampLatch"]
    clock = find_clock(camera, "camera c0")
    assert not clock.remote
    before_ns = time.time_ns()
    assert before_ns <= clock.read_ns() <= time.time_ns()


def test_a_camera_without_a_latch_is_refused() -> None:
    camera = StandInCamera()
    del camera.device.features["TimestampLatchValue"]
    with pytest.raises(DeviceError, match="camera c0: has no time stamp that can be latched") as refused:
        find_clock(camera, "camera c0")
    assert refused.value.code == "clock-unknown"
