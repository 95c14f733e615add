"""The controller at a serial port, from its events to its restoration after failures."""

from __future__ import annotations

import os
import re
import select
import threading
import time
import tty
from collections.abc import Callable, Iterator
from concurrent.futures import ThreadPoolExecutor
from contextlib import closing, contextmanager
from dataclasses import replace
from itertools import pairwise
from queue import SimpleQueue
from typing import TypeVar

import pytest
from hypothesis import given
from hypothesis import strategies as st

from tests.acquisition.controller.serial.fake_firmware import FakeFirmware
from tests.hw.emulated.vectors import IDENT
from vaoi_station.acquisition.cameras.interface import DeviceFault
from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    ControllerEvent,
    EventQueue,
    LineOutput,
    Permit,
    PulseFired,
    PulseSkipped,
    RunEnded,
    TriggerPlan,
)
from vaoi_station.acquisition.controller.protocol import (
    REPLY,
    ROW_NONE,
    Event,
    Fault,
    FrameReader,
    Kind,
    Message,
    Nak,
    Reason,
    RunEnd,
    State,
    Suppressed,
    Type,
    encode,
)
from vaoi_station.acquisition.controller.serial import SerialController
from vaoi_station.acquisition.controller.serial.controller import EventTranslator
from vaoi_station.acquisition.controller.serial.exchange import RefusalError
from vaoi_station.config import ControllerConfig, LightConfig
from vaoi_station.errors import DeviceError, InputError, StateError


class Recorder:
    def __init__(self) -> None:
        self.translator = EventTranslator()
        self.events: list[ControllerEvent | DeviceFault] = []
        self.translator.put = self.events.append
        self.translator.light = lambda row, channels: f"light {row} of {channels:b}"
        self.translator.single_light = "single light"

    def receive(self, *events: tuple[Kind, int, int, int]) -> list[ControllerEvent | DeviceFault]:
        """(kind, detail, index, value) each, a second apart."""
        for number, (kind, detail, index, value) in enumerate(events):
            self.translator.translate(Event(number, 2_000_000 * number, kind, detail, index, value), float(number))
        return self.events


def test_rows_left_out_are_rows_of_the_run() -> None:
    events = Recorder().receive(
        (Kind.BARRIER, 1, 7, 0),
        (Kind.SUPPRESSED, Suppressed.LED_BUDGET, 0, 2),
        (Kind.PULSE, 0b101, 1, 600),
        (Kind.SUPPRESSED, Suppressed.LATE, 2, 0),
        (Kind.BARRIER, 0, 7, 0),
        (Kind.RUN_END, RunEnd.CLEAR, 1, 2),
    )
    assert [type(t).__name__ for t in events] == [
        "BarrierBlocked", "PulseSkipped", "PulseFired", "PulseSkipped", "BarrierClear", "RunEnded",
    ]  # fmt: skip
    skipped = [t for t in events if isinstance(t, PulseSkipped)]
    assert [s.index for s in skipped] == [0, 2]
    assert "had not cooled down" in skipped[0].reason
    end = events[-1]
    assert isinstance(end, RunEnded)
    assert (end.pulses, end.reason) == (3, "clear")
    assert isinstance(events[2], PulseFired)
    assert (events[2].light, events[2].on_us) == ("light 1 of 101", 300.0)


EVENTS = st.tuples(
    st.sampled_from(sorted(Kind)), st.integers(0, 5), st.sampled_from([0, 1, 2, 5, ROW_NONE]), st.integers(0, 9)
)


@given(st.lists(EVENTS, max_size=30))
def test_whatever_is_lost_runs_do_not_overlap_and_numbers_have_no_gaps(
    events: list[tuple[Kind, int, int, int]],
) -> None:
    recorder = Recorder()
    recorder.receive(*events)
    recorder.translator.end("over")
    reported = [t for t in recorder.events if isinstance(t, ControllerEvent)]
    assert all(b.number == a.number + 1 for a, b in pairwise(reported))
    open_runs = 0
    for event in reported:
        if isinstance(event, BarrierBlocked):
            assert open_runs == 0
            open_runs = 1
        elif isinstance(event, RunEnded) and event.reason != "single":
            open_runs = 0
    assert open_runs == 0
    assert not recorder.translator.end("again")


PLAN = TriggerPlan(start_delay_s=0.3, period_s=0.12, tail_s=0.4, max_rows=40, debounce_s=0.005)

LIGHTS = {"top": LightConfig(channels=(0,), on_us=300.0)}
Device = tuple[str, FakeFirmware]
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


def refusal(port: str) -> DeviceError:
    with pytest.raises(DeviceError) as refused:
        SerialController(ControllerConfig(backend="serial", port=port))
    assert refused.value.action
    return refused.value


@pytest.mark.parametrize(
    ("ident", "code", "words"),
    [
        (b"\2\0" + bytes(10), "protocol-version", r"speaks protocol 2\.0, this station 1\.4"),
        (replace(IDENT, major=3).pack(), "protocol-version", r"speaks protocol 3\.4"),
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


@pytest.fixture
def controller(device: Device) -> Iterator[SerialController]:
    device[1].state = State.ARMED
    with closing(SerialController(ControllerConfig(backend="serial", port=device[0], lights=LIGHTS))) as controller:
        assert device[1].in_state(State.IDLE), "an earlier process left it armed"
        yield controller


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


def test_the_thread_at_the_port_is_supervised_until_the_end(
    controller: SerialController, events: EventQueue, monkeypatch: pytest.MonkeyPatch
) -> None:
    [thread] = controller.threads()
    controller.arm(PLAN)
    assert thread.fault() is None
    beats = threading.Semaphore(0)
    monkeypatch.setattr(thread, "beat", beats.release)
    assert beats.acquire(timeout=20), "it shows that it is alive while nothing happens"


def test_after_its_guard_tripped_it_stays_disarmed(
    controller: SerialController, events: EventQueue, device: Device
) -> None:
    controller.arm(PLAN)
    device[1].state = State.SAFE
    device[1].emit(Kind.FAULT, Fault.GUARD)
    assert until(events, DeviceFault).error.code == "controller-safe"
    assert not controller.is_watching()
    beats = device[1].requests.count(Type.BEAT)
    while device[1].requests.count(Type.BEAT) < beats + 2:
        controller.read_clock()
    assert device[1].in_state(State.SAFE)
    controller.arm(PLAN)
    assert device[1].in_state(State.ARMED)


@pytest.mark.parametrize(
    ("reason", "words"), [(Reason.LED_BUDGET, "have not cooled down"), (Reason.STATE, "is still under way")]
)
def test_a_pulse_that_must_wait_is_no_fault(
    controller: SerialController, events: EventQueue, device: Device, reason: Reason, words: str
) -> None:
    device[1].refuse[Type.FIRE_ONE] = Nak(Type.FIRE_ONE, reason, 0, 0)
    with pytest.raises(StateError, match=words):
        controller.fire_one()
    device[1].refuse.clear()
    controller.fire_one()
    assert until(events, PulseFired).light == "top"


def test_a_refused_job_does_not_end_the_connection(
    controller: SerialController, events: EventQueue, device: Device
) -> None:
    asked = device[1].requests.count(Type.IDENT)  # asked again by itself if the reply comes late
    device[1].refuse[Type.COMMIT] = Nak(Type.COMMIT, Reason.RANGE, 4, 1_000_000)
    with pytest.raises(InputError, match=r"period_s is 0\.12, but must be at least 0\.5"):
        controller.arm(PLAN)
    device[1].refuse = {Type.ARM: Nak(Type.ARM, Reason.STATE, 0, 3)}
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


def test_an_armed_controller_that_becomes_silent_is_reported_and_armed_again(
    controller: SerialController, events: EventQueue, device: Device
) -> None:
    controller.arm(PLAN)
    device[1].mute = True
    assert until(events, DeviceFault).error.code == "controller-silent"
    with pytest.raises(DeviceError):
        controller.read_clock()
    assert "not reachable" in controller.health()
    device[1].state = State.SAFE  # the firmware does this itself after 3 s without a heartbeat
    device[1].mute = False
    wait_reachable(controller)
    assert device[1].in_state(State.ARMED)
    assert controller.health().startswith("serial: armed")


@pytest.mark.parametrize("calls", [("close",), ("disarm", "close")], ids=["closed", "disarmed"])
def test_an_armed_controller_that_is_silent_can_be_disarmed_and_closed(device: Device, calls: tuple[str, ...]) -> None:
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


def wait_output(controller: SerialController, *, high: bool) -> LineOutput:
    deadline_s = time.monotonic() + 20
    while (output := controller.line_output()) is None or output.high != high:
        assert time.monotonic() < deadline_s
    return output


def test_a_permit_reaches_an_armed_controller(device: Device) -> None:
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
