"""Requests over a terminal: replies, refusals, resets, silence and a port that goes."""

from __future__ import annotations

import os
import time
from collections.abc import Callable, Iterator
from contextlib import closing
from types import SimpleNamespace

import pytest

from tests.acquisition.controller.serial.fake_firmware import FakeFirmware
from vaoi_station.acquisition.controller.protocol import (
    MAX_TRIES,
    RETRY_S,
    ClockReply,
    EventReceived,
    EventsLost,
    Kind,
    Link,
    Nak,
    Reason,
    Request,
    State,
    Type,
    number_request,
)
from vaoi_station.acquisition.controller.serial import exchange as exchange_module
from vaoi_station.acquisition.controller.serial.exchange import (
    Exchange,
    Port,
    PortLostError,
    RefusalError,
    ResetError,
    SilentError,
    Waker,
)
from vaoi_station.errors import DeviceError

Device = tuple[str, FakeFirmware]


class Bench:
    """An exchange and the events that it passed on."""

    def __init__(self, name: str, waker: Waker) -> None:
        self.port = Port(name, 250_000, waker)
        self.events: list[EventReceived | EventsLost] = []
        self.exchange = Exchange(self.port, Link(), lambda item, _now_s: self.events.append(item), name)


@pytest.fixture
def bench(device: Device) -> Iterator[Bench]:
    with closing(Waker()) as waker:
        bench = Bench(device[0], waker)
        yield bench
        bench.port.close()


def test_a_request_returns_its_reply(bench: Bench) -> None:
    replied = bench.exchange.request(number_request(Type.CLOCK, 77))
    assert ClockReply.unpack(replied.payload).nonce == 77
    assert replied.sent_s <= replied.received_s
    assert bench.exchange.silence_s < 5


def test_a_refusal_has_the_controllers_reason(bench: Bench, device: Device) -> None:
    device[1].refuse[Type.SAFE] = Nak(Type.SAFE, Reason.STATE, 0, State.RUNNING)
    with pytest.raises(RefusalError, match="SAFE was refused: the controller is RUNNING") as refused:
        bench.exchange.request(Request(Type.SAFE))
    assert refused.value.nak.reason == Reason.STATE


def test_a_controller_that_does_not_reply(bench: Bench, device: Device) -> None:
    device[1].mute = True
    with pytest.raises(SilentError, match="does not answer"):
        bench.exchange.request(Request(Type.SAFE))
    assert device[1].requests == [Type.SAFE] * 10


def test_a_reply_that_waits_in_the_port_is_not_missed(
    bench: Bench, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    """The reply to the last transmission arrives while the computer does not run this process."""
    firmware = device[1]
    firmware.mute = True
    read, paused_s = bench.port.read, 0.0
    clock = SimpleNamespace(monotonic=lambda: time.monotonic() + paused_s)

    def read_and_pause(wait_s: float) -> bytes:
        nonlocal paused_s
        data = read(wait_s)
        if firmware.mute and len(firmware.requests) == MAX_TRIES:
            firmware.reply_late()
            paused_s = 1.5 * RETRY_S
        return data

    monkeypatch.setattr(bench.port, "read", read_and_pause)
    monkeypatch.setattr(exchange_module, "time", clock)
    replied = bench.exchange.request(number_request(Type.CLOCK, 77))
    assert ClockReply.unpack(replied.payload).nonce == 77


def test_a_status_comes_after_all_events_before_it(bench: Bench, device: Device) -> None:
    bench.exchange.read_status()
    for row in range(5):
        device[1].emit(Kind.PULSE, 1, row)
    status = bench.exchange.read_status()
    assert status.events_next == 5
    assert [e.event.index for e in bench.events if isinstance(e, EventReceived)] == list(range(5))


def test_a_reset_is_an_error_for_the_request_under_way(bench: Bench, device: Device) -> None:
    bench.exchange.read_status()
    device[1].reset()
    with pytest.raises(ResetError, match="start number 2"):
        bench.exchange.request(Request(Type.STATUS))
    assert bench.exchange.request(Request(Type.STATUS))


def test_a_controller_is_identified_although_it_was_reset(bench: Bench, device: Device) -> None:
    """Opening a port may itself reset the board."""
    bench.exchange.read_status()
    device[1].reset()
    assert bench.exchange.identify()[:2] == b"\1\3"


def test_nothing_is_identified_where_nothing_replies(
    bench: Bench, device: Device, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(exchange_module, "IDENTIFY_S", 0.01)
    device[1].mute = True
    with pytest.raises(DeviceError) as refused:
        bench.exchange.identify()
    assert refused.value.code == "controller-silent"


@pytest.mark.parametrize("failing", ["read", "write"])
def test_a_port_that_goes(bench: Bench, monkeypatch: pytest.MonkeyPatch, failing: str) -> None:
    def gone(*_arguments: object) -> bytes:
        raise OSError(5, os.strerror(5))

    monkeypatch.setattr(bench.port, failing, gone)
    with pytest.raises(PortLostError, match="has gone") as lost:
        bench.exchange.request(Request(Type.STATUS))
    assert lost.value.code == "port-lost"


def test_the_errors_have_the_codes_of_the_documentation() -> None:
    kinds: list[Callable[..., DeviceError]] = [SilentError, PortLostError, ResetError, RefusalError]
    codes = [kind("x").code for kind in kinds]
    assert codes == ["controller-silent", "port-lost", "controller-reset", "controller-refused"]
