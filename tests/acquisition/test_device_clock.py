"""Tests of the clocks of simulated devices."""

from __future__ import annotations

import time
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.clocks import DeviceClock, simulated_clock


@given(st.floats(-1e5, 1e5), st.floats(-200, 200), st.floats(0, 1e5))
def test_device_time_and_host_time_are_inverse(offset_s: float, drift_ppm: float, host_s: float) -> None:
    clock = DeviceClock(offset_s, drift_ppm, origin_s=10.0)
    assert clock.host_s(clock.device_s(host_s)) == pytest.approx(host_s, abs=1e-6)


def test_a_drift_of_50_ppm_gains_50_us_in_a_second() -> None:
    clock = DeviceClock(0.0, 50.0, origin_s=100.0)
    assert clock.device_s(101.0) - clock.device_s(100.0) == pytest.approx(1.00005, abs=1e-9)


def test_a_reading_is_right_within_its_bound() -> None:
    clock = simulated_clock(3)
    for _ in range(100):
        reading = clock.read()
        assert reading.bound_s >= 0
        assert abs(clock.host_s(reading.device_s) - reading.host_s) <= reading.bound_s + 1e-9


def test_an_exact_reading_has_no_bound_and_shows_the_present() -> None:
    clock = DeviceClock(7.0, 0.0, origin_s=0.0)
    before_s = time.monotonic()
    reading = clock.read_exactly()
    assert before_s <= reading.host_s <= time.monotonic()
    assert reading.bound_s == 0.0
    assert reading.device_s == pytest.approx(reading.host_s + 7.0)
    assert clock.now_s() >= reading.device_s


def test_simulated_clocks_differ_by_hours_and_at_most_50_ppm() -> None:
    clocks = [simulated_clock(number) for number in range(-1, 99)]
    assert len({c.drift_ppm for c in clocks}) == len(clocks)
    assert all(abs(c.drift_ppm) <= 50 for c in clocks)
    offsets = sorted(c.offset_s for c in clocks)
    assert all(b - a > 3000 for a, b in pairwise(offsets))
