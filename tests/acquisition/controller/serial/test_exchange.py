"""The serial port, its requests and replies, and the time of the controller."""

from __future__ import annotations

import fcntl
import os
import termios
import tty
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.clocks import ClockModel
from vaoi_station.acquisition.controller.protocol import (
    TICK_S,
)
from vaoi_station.acquisition.controller.serial.exchange import (
    BOOT_SPACING_S,
    Port,
    Timebase,
    Waker,
)
from vaoi_station.errors import DeviceError

TURN_S = 2**32 * TICK_S


def tick_at(seconds: float) -> int:
    """What the counter shows so long after the reset."""
    return int(seconds / TICK_S) % 2**32


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
    clock = Timebase(10**9)
    rate = 1 + drift_ppm * 1e-6
    host_s = start_s
    for there_s, back_s in delays:
        host_s += 1.0
        clock.add_reply(tick_at((host_s + there_s) * rate), offset_s + host_s, offset_s + host_s + there_s + back_s)
    event_s = host_s + ahead_s
    if event_s < 0:
        return
    tick, near_s = tick_at(event_s * rate), offset_s + host_s
    device_s = clock.time_s(tick, near_s)
    error_s = abs(clock.model.host_s(device_s) - (offset_s + event_s))
    assert error_s <= clock.model.bound_s(device_s) + 2 * TICK_S


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


@pytest.fixture
def terminal() -> Iterator[tuple[int, str]]:
    """The other end of a terminal, and the name of this one."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    yield ours, os.ttyname(theirs)
    os.close(theirs)
    os.close(ours)


@pytest.fixture
def waker() -> Iterator[Waker]:
    with closing(Waker()) as waker:
        yield waker


def test_a_device_that_hangs_up_is_an_error(waker: Waker) -> None:
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    name = os.ttyname(theirs)
    os.close(theirs)
    with closing(Port(name, 250_000, waker)) as port:
        os.close(ours)
        with pytest.raises(OSError, match=r"hung up|Input/output error"):
            port.read(5.0)


def test_a_port_that_is_not_there(tmp_path: Path, waker: Waker) -> None:
    with pytest.raises(DeviceError) as refused:
        Port(str(tmp_path / "vaoi-trigger"), 250_000, waker)
    assert refused.value.code == "port-absent"
    assert "71-vaoi-controller.rules" in refused.value.action


def test_a_port_in_use(terminal: tuple[int, str], waker: Waker) -> None:
    """Serial programs agree on this lock."""
    handle = os.open(terminal[1], os.O_RDWR | os.O_NOCTTY)
    fcntl.flock(handle, fcntl.LOCK_EX)
    with pytest.raises(DeviceError) as refused:
        Port(terminal[1], 250_000, waker)
    os.close(handle)
    assert refused.value.code == "port-in-use"
    assert "fuser" in refused.value.action


def test_a_port_without_permission(waker: Waker, monkeypatch: pytest.MonkeyPatch) -> None:
    def forbidden(*_arguments: object, **_options: object) -> None:
        raise PermissionError(13, "Permission denied")

    monkeypatch.setattr("serial.Serial", forbidden)
    with pytest.raises(DeviceError) as refused:
        Port("/dev/any", 250_000, waker)
    assert refused.value.code == "port-forbidden"
    assert "dialout" in refused.value.action


def test_closing_a_port_does_not_reset_the_board_behind_it(terminal: tuple[int, str], waker: Waker) -> None:
    """DTR falls at the last close only if HUPCL is set."""
    handle = os.open(terminal[1], os.O_RDWR | os.O_NOCTTY)
    flags = termios.tcgetattr(handle)
    flags[2] |= termios.HUPCL
    termios.tcsetattr(handle, termios.TCSANOW, flags)
    Port(terminal[1], 250_000, waker).close()
    assert not termios.tcgetattr(handle)[2] & termios.HUPCL
    os.close(handle)
