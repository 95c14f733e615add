"""The emulated chip behind a terminal: what a station receives, and the output of the side channel."""

from __future__ import annotations

import time

import serial

from tests.hw.emulated.paced import HZ, PATIENCE_S, PacedChip
from vaoi_station.acquisition.controller.protocol import Ident, Link, Replied, Request, Type


def identify(port: serial.Serial) -> Ident:
    """Repeat IDENT until it is answered, as a station does."""
    link, give_up_s = Link(), time.monotonic() + PATIENCE_S
    while time.monotonic() < give_up_s:
        link.request(Request(Type.IDENT))
        while time.monotonic() < give_up_s:
            if data := link.outgoing(time.monotonic()):
                port.write(data)
            news = link.receive(port.read(max(1, port.in_waiting)), time.monotonic())
            for item in news:
                if isinstance(item, Replied):
                    return Ident.unpack(item.payload)
            if news:
                break
    raise AssertionError("it did not identify itself")


def test_it_answers_at_the_terminal_and_keeps_the_pace(paced: PacedChip) -> None:
    with serial.Serial(str(paced.link), 250_000, timeout=0.005) as port:
        assert identify(port).boots == 1
    first = paced.do("pin PB0 0")
    before_s = time.monotonic()
    cycle = paced.do("pin PB0 0")
    after_s = time.monotonic()
    assert first <= cycle
    assert paced.host_s(cycle) <= after_s
    assert paced.host_s(cycle) >= before_s - PATIENCE_S  # a busy computer is caught up with


def test_a_reset_with_a_bootloader_swallows_what_comes(paced: PacedChip) -> None:
    with serial.Serial(str(paced.link), 250_000, timeout=0.005) as port:
        identify(port)
        cycle = paced.do("reset external 700")
        reset_s = time.monotonic()
        assert paced.resets == [cycle]
        assert identify(port).boots == 2
        assert paced.host_s(cycle) > reset_s
        assert time.monotonic() >= paced.host_s(cycle)


def test_noise_damages_and_a_plug_that_was_pulled_comes_back(paced: PacedChip) -> None:
    with serial.Serial(str(paced.link), 250_000, timeout=0.005) as port:
        paced.do("noise 0.01 0.01 7")
        identify(port)
        paced.do("noise 0 0")
        paced.do("unplug")
        assert not paced.link.exists()
    paced.do("plug")
    with serial.Serial(str(paced.link), 250_000, timeout=0.005) as port:
        assert identify(port).boots == 1


def test_a_watchdog_reset_is_reported(paced: PacedChip) -> None:
    with serial.Serial(str(paced.link), 250_000, timeout=0.005) as port:
        assert identify(port).reset_cause == 1
        paced.do("hang")
        paced.wait(lambda: paced.resets)
        assert identify(port).reset_cause == 8


def test_outputs_rise_low_and_boards_leave(paced: PacedChip) -> None:
    """Nothing was armed: a board passes, and no pin moves."""
    start = paced.board(20)
    while paced.do("pin PD2 0") < start + HZ // 20:
        pass
    assert paced.edges == []
