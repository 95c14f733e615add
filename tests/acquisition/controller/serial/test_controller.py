"""The serial controller at pseudo terminals: unsuitable devices are refused, failures are reported and repaired."""

from __future__ import annotations

import os
import re
import select
import threading
import time
import tty
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import contextmanager
from dataclasses import replace
from queue import SimpleQueue
from typing import TypeVar

import pytest

from tests.acquisition.controller.serial.fake_firmware import FakeFirmware
from tests.hw.emulated.vectors import IDENT
from vaoi_station.acquisition.cameras.interface import DeviceFault
from vaoi_station.acquisition.clocks import ClockReading
from vaoi_station.acquisition.controller.interface import (
    EventQueue,
    LineOutput,
    Permit,
    PulseFired,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.acquisition.controller.protocol import (
    REPLY,
    FrameReader,
    Kind,
    Message,
    Nak,
    Reason,
    State,
    Type,
    encode,
)
from vaoi_station.acquisition.controller.serial import SerialController, exchange
from vaoi_station.acquisition.controller.serial.exchange import RefusalError
from vaoi_station.config import ControllerConfig
from vaoi_station.errors import DeviceError

PLAN = TriggerPlan(start_delay_s=0.3, period_s=0.12, tail_s=0.4, max_rows=40, debounce_s=0.005)

E = TypeVar("E")


@contextmanager
def terminal(answer: Callable[[bytes], bytes]) -> Iterator[str]:
    """A terminal whose other end answers every piece of data."""
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    end, stop = os.pipe()

    def work() -> None:
        while end not in (ready := select.select([ours, end], [], [])[0]):
            if ours in ready:
                os.write(ours, answer(os.read(ours, 4096)))

    thread = threading.Thread(target=work)
    thread.start()
    try:
        yield os.ttyname(theirs)
    finally:
        os.close(stop)
        thread.join()
        for handle in (ours, theirs, end):
            os.close(handle)


def replies_ident(ident: bytes) -> Callable[[bytes], bytes]:
    """Reply to IDENT with this, and to nothing else."""
    reader = FrameReader()

    def answer(data: bytes) -> bytes:
        asked = [m for m in reader.feed(data) if m.type == Type.IDENT]
        return b"".join(encode(Message(Type.IDENT | REPLY, m.sequence, ident)) for m in asked)

    return answer


@pytest.fixture
def impatient(monkeypatch: pytest.MonkeyPatch) -> None:
    """No bootloader has to be waited for."""
    monkeypatch.setattr(exchange, "IDENTIFY_S", 0.01)


def refusal(port: str) -> DeviceError:
    with pytest.raises(DeviceError) as refused:
        SerialController(ControllerConfig(backend="serial", port=port))
    assert refused.value.action
    return refused.value


@pytest.mark.parametrize(
    ("ident", "code", "words"),
    [
        (b"\2\0" + bytes(10), "protocol-version", r"speaks protocol 2\.0, this station 1\.3"),
        (replace(IDENT, major=3).pack(), "protocol-version", r"speaks protocol 3\.3"),
        (replace(IDENT, firmware_major=0, firmware_minor=9).pack(), "firmware-too-old", r"has firmware 0\.9\.3"),
        (replace(IDENT, board=b"printer\0").pack(), "foreign-device", "calls itself b'printer'"),
    ],
    ids=["2.0", "3.0", "old firmware", "printer"],
)
def test_another_version_or_make(ident: bytes, code: str, words: str) -> None:
    with terminal(replies_ident(ident)) as port:
        error = refusal(port)
    assert error.code == code
    assert re.search(words, error.message)


@pytest.mark.usefixtures("impatient")
def test_a_device_with_another_protocol() -> None:
    with terminal(lambda data: b"$GPGGA,123519,4807.038,N\r\n" * 3) as port:
        error = refusal(port)
    assert error.code == "foreign-device"
    assert "no message of the trigger controller's protocol" in error.message


@pytest.mark.usefixtures("impatient")
def test_a_device_that_is_silent() -> None:
    with terminal(lambda data: b"") as port:
        assert refusal(port).code == "controller-silent"


@pytest.fixture
def controller(device: tuple[str, FakeFirmware]) -> Iterator[SerialController]:
    controller = SerialController(ControllerConfig(backend="serial", port=device[0]))
    yield controller
    controller.close()


@pytest.fixture
def events(controller: SerialController) -> EventQueue:
    """The events of a started controller."""
    events: EventQueue = SimpleQueue()
    controller.start(events)
    return events


def until(events: EventQueue, kind: type[E]) -> E:
    """The next item of a kind; others are dropped."""
    while not isinstance(item := events.get(timeout=20), kind):
        pass
    return item


def test_events_come_while_no_request_is_made(
    controller: SerialController, events: EventQueue, device: tuple[str, FakeFirmware]
) -> None:
    controller.arm(PLAN)
    device[1].state = State.RUNNING
    device[1].emit(Kind.BARRIER, 1)
    device[1].emit(Kind.PULSE, 1, 0, 600)
    assert until(events, PulseFired).index == 0
    controller.disarm()
    assert until(events, RunEnded).reason == "disarmed"


def test_the_thread_at_the_port_is_supervised_until_the_end(
    controller: SerialController, events: EventQueue, monkeypatch: pytest.MonkeyPatch
) -> None:
    [thread] = controller.threads()
    controller.arm(PLAN)
    assert thread.fault() is None
    beats = threading.Semaphore(0)
    monkeypatch.setattr(thread, "beat", beats.release)
    assert beats.acquire(timeout=20), "it shows that it is alive while nothing happens"


def test_health_names_state_firmware_and_clock(controller: SerialController, events: EventQueue) -> None:
    assert controller.health().startswith("serial: idle, firmware 1.2.3, start 1, clock ±")
    controller.arm(PLAN)
    assert controller.health().startswith("serial: armed")
    assert controller.clock_bound_s < 1.0
    assert controller.ident.channels == 4


def test_a_clock_can_be_read_from_several_threads(controller: SerialController, events: EventQueue) -> None:
    with ThreadPoolExecutor(4) as pool:
        readings = list(pool.map(lambda _: controller.read_clock(), range(40)))
    assert all(reading.bound_s >= 0 for reading in readings)


def test_a_refused_job_does_not_end_the_connection(
    controller: SerialController, events: EventQueue, device: tuple[str, FakeFirmware]
) -> None:
    asked = device[1].requests.count(Type.IDENT)  # asked again by itself if the reply comes late
    device[1].refuse[Type.ARM] = Nak(Type.ARM, Reason.STATE, 0, 3)
    with pytest.raises(RefusalError, match="ARM was refused"):
        controller.arm(PLAN)
    device[1].refuse.clear()
    controller.arm(PLAN)
    assert device[1].requests.count(Type.IDENT) == asked, "it was not opened again"


def wait_reachable(controller: SerialController) -> None:
    """Until requests are accepted again; the clock is read before the connection is complete."""
    deadline_s = time.monotonic() + 20
    while "not reachable" in controller.health():
        assert time.monotonic() < deadline_s


def test_a_silent_controller_is_reported_and_opened_again(
    controller: SerialController, events: EventQueue, device: tuple[str, FakeFirmware]
) -> None:
    device[1].mute = True
    assert until(events, DeviceFault).error.code == "controller-silent"
    with pytest.raises(DeviceError):
        controller.read_clock()
    assert "not reachable" in controller.health()
    device[1].mute = False
    until(events, ClockReading)
    wait_reachable(controller)
    controller.arm(PLAN)
    assert device[1].in_state(State.ARMED)


def test_an_armed_controller_that_becomes_silent_is_reported_and_armed_again(
    controller: SerialController, events: EventQueue, device: tuple[str, FakeFirmware]
) -> None:
    """Its port stays open, so nothing but the missing replies shows it."""
    controller.arm(PLAN)
    device[1].mute = True
    assert until(events, DeviceFault).error.code == "controller-silent"
    assert "not reachable" in controller.health()
    device[1].state = State.SAFE  # the firmware does this itself after 3 s without a heartbeat
    device[1].mute = False
    wait_reachable(controller)
    assert device[1].in_state(State.ARMED)
    assert controller.health().startswith("serial: armed")


@pytest.mark.parametrize("calls", [("close",), ("disarm", "close")], ids=["closed", "disarmed"])
def test_an_armed_controller_that_is_silent_can_be_disarmed_and_closed(
    device: tuple[str, FakeFirmware], calls: tuple[str, ...]
) -> None:
    controller = SerialController(ControllerConfig(backend="serial", port=device[0]))
    controller.start(SimpleQueue())
    controller.arm(PLAN)
    device[1].mute = True
    with ThreadPoolExecutor(1) as caller:
        try:
            for call in calls:
                caller.submit(getattr(controller, call)).result(timeout=10)
        finally:
            device[1].mute = False  # so that the threads end even if this test fails


def test_closing_disarms(device: tuple[str, FakeFirmware]) -> None:
    controller = SerialController(ControllerConfig(backend="serial", port=device[0]))
    controller.start(SimpleQueue())
    controller.arm(PLAN)
    controller.close()
    assert device[1].in_state(State.IDLE)
    with pytest.raises(DeviceError):
        controller.read_clock()


def wait_output(controller: SerialController, *, high: bool) -> LineOutput:
    deadline_s = time.monotonic() + 20
    while (output := controller.line_output()) is None or output.high != high:
        assert time.monotonic() < deadline_s
    return output


def test_a_permit_reaches_an_armed_controller(device: tuple[str, FakeFirmware]) -> None:
    controller = SerialController(ControllerConfig(backend="serial", port=device[0], interlock="on"))
    controller.start(SimpleQueue())
    try:
        controller.permit_board(Permit(1, time.monotonic() + 1e3))
        assert wait_output(controller, high=False).why.startswith("the controller is not armed")
        controller.arm(PLAN)
        wait_output(controller, high=True)
        assert ", line ready, firmware" in controller.health()
        controller.permit_board(None)
        assert wait_output(controller, high=False).why == "the station does not permit a board"
        assert device[1].permits[-1] == bytes([1, 0, 0, 0])
    finally:
        controller.close()


def test_without_an_interlock_no_permit_is_sent(
    controller: SerialController, events: EventQueue, device: tuple[str, FakeFirmware]
) -> None:
    controller.permit_board(Permit(1, time.monotonic() + 1e3))
    controller.arm(PLAN)
    assert Type.READY not in device[1].requests
    assert controller.line_output() is None
    assert controller.is_watching()


def test_firmware_without_the_output_is_used_unless_an_interlock_is_demanded(device: tuple[str, FakeFirmware]) -> None:
    device[1].ident = replace(IDENT, minor=1, ready_longest_ms=0)
    controller = SerialController(ControllerConfig(backend="serial", port=device[0]))
    assert "no output 'line ready'" in controller.health()
    controller.close()
    with pytest.raises(DeviceError, match="which has no output 'line ready'") as refused:
        SerialController(ControllerConfig(backend="serial", port=device[0], interlock="on"))
    assert refused.value.code == "interlock-missing"
