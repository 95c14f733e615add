"""Ticks of all starts of the controller on one axis."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.clocks import ClockModel
from vaoi_station.acquisition.controller.serial.exchange import BOOT_SPACING_S, Timebase

BAUD = 250_000
THERE_S, BACK_S = 100 / BAUD, 140 / BAUD
"""Question and answer on the line."""


@given(
    delays=st.lists(st.tuples(st.floats(1e-6, 2e-3), st.floats(0, 2e-3)), min_size=1, max_size=20),
    start_s=st.floats(0, 1e5),
)
def test_a_reading_is_never_further_off_than_its_bound(delays: list[tuple[float, float]], start_s: float) -> None:
    """Whatever bridges and kernels add on either way; ticks wrap every 36 minutes, and these are 10 minutes apart."""
    timebase = Timebase(BAUD)
    for k, (before_s, after_s) in enumerate(delays):
        true_s = start_s + 600.0 * k
        tick = round((true_s - start_s) * 2e6) % 2**32
        reading = timebase.add_reply(tick, true_s - THERE_S - before_s, true_s + BACK_S + after_s)
        assert reading.device_s == pytest.approx(600.0 * k, abs=1e-6)
        assert abs(reading.host_s - true_s) <= reading.bound_s + 1e-6
        assert reading.bound_s == pytest.approx((before_s + after_s) / 2, abs=1e-6)


def test_an_answer_faster_than_the_line_is_not_believed_to_be_better() -> None:
    assert Timebase(BAUD).add_reply(0, 10.0, 10.0004).bound_s == pytest.approx(0.0002)


def test_every_start_is_a_jump_that_a_clock_model_notices() -> None:
    timebase, model = Timebase(BAUD), ClockModel("controller")
    for k in range(10):
        model.add(timebase.add_reply(2_000_000 * k, 100.0 + k - 0.001, 100.0 + k + 0.001))
    last_s = timebase.time_s(20_000_000, 110.0)
    timebase.restart()
    reading = timebase.add_reply(1000, 111.0, 111.002)
    assert reading.device_s == pytest.approx(last_s + BOOT_SPACING_S + 0.0005)
    model.add(reading)
    assert model.restarts == 1
    assert abs(model.host_s(reading.device_s) - 111.001) <= reading.bound_s
