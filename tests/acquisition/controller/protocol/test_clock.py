"""Ticks of 32 bits to host times: wraps are counted, and the bound holds."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.controller.protocol import TICK_S
from vaoi_station.acquisition.controller.serial.exchange import TickClock
from vaoi_station.errors import DeviceError

TURN_S = 2**32 * TICK_S


def tick_at(seconds: float) -> int:
    """What the counter shows so long after the reset."""
    return int(seconds / TICK_S) % 2**32


def host_time(clock: TickClock, tick: int, near_s: float) -> float:
    return clock.model.host_s(clock.device_s(tick, near_s))


@given(
    drift_ppm=st.floats(-100, 100),
    offset_s=st.floats(0, 1e5),
    start_s=st.floats(0, 3 * TURN_S),
    delays=st.lists(st.tuples(st.floats(1e-4, 5e-3), st.floats(1e-4, 5e-3)), min_size=3, max_size=30),
    ahead_s=st.floats(-5, 5),
)
def test_the_host_time_of_a_tick_is_within_the_bound(
    drift_ppm: float, offset_s: float, start_s: float, delays: list[tuple[float, float]], ahead_s: float
) -> None:
    """There and back take different times; the bound must allow for that."""
    clock = TickClock()
    rate = 1 + drift_ppm * 1e-6
    host_s = start_s
    for there_s, back_s in delays:
        host_s += 1.0
        clock.add(tick_at((host_s + there_s) * rate), offset_s + host_s, offset_s + host_s + there_s + back_s)
    event_s = host_s + ahead_s
    if event_s < 0:
        return
    tick, near_s = tick_at(event_s * rate), offset_s + host_s
    error_s = abs(host_time(clock, tick, near_s) - (offset_s + event_s))
    assert error_s <= clock.model.bound_s(clock.device_s(tick, near_s)) + 2 * TICK_S


def test_ticks_are_unambiguous_across_several_wraps() -> None:
    clock = TickClock()
    for k in range(200):  # an hour and 40 minutes, asked every half minute
        host_s = 100.0 + 30.0 * k
        clock.add(tick_at(30.0 * k), host_s - 1e-4, host_s + 1e-4)
    assert clock.model.restarts == 0
    assert host_time(clock, tick_at(30.0 * 199 - 900), 100 + 30.0 * 199) == pytest.approx(
        100 + 30.0 * 199 - 900, abs=1e-3
    )


def test_nothing_is_known_before_the_first_reading() -> None:
    with pytest.raises(DeviceError, match="never been read"):
        host_time(TickClock(), 5, 0.0)
