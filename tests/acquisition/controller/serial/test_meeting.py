"""Devices that are not our controller, behind real terminals: each is refused with a sentence that says what to do."""

from __future__ import annotations

import os
import re
import select
import termios
import threading
import tty
from collections.abc import Callable, Iterator
from contextlib import contextmanager
from dataclasses import replace
from pathlib import Path

import pytest

from tests.hw.emulated.vectors import IDENT
from vaoi_station.acquisition.controller.protocol.framing import FrameReader, Message, encode
from vaoi_station.acquisition.controller.protocol.messages import REPLY, Type
from vaoi_station.acquisition.controller.serial import SerialController
from vaoi_station.acquisition.controller.serial.port import Port, Waker
from vaoi_station.config import ControllerConfig
from vaoi_station.errors import DeviceError


@contextmanager
def device(answer: Callable[[bytes], bytes]) -> Iterator[str]:
    """A terminal at whose other end every piece of what comes is answered."""
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


def says(ident: bytes) -> Callable[[bytes], bytes]:
    """Answers IDENT with this, and nothing else."""
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
        (b"\2\0" + bytes(10), "protocol-version", r"speaks protocol 2\.0, this station 1\.0"),
        (replace(IDENT, major=3).pack(), "protocol-version", r"speaks protocol 3\.0"),
        (replace(IDENT, firmware_major=0, firmware_minor=9).pack(), "firmware-too-old", r"has firmware 0\.9\.3"),
        (replace(IDENT, board=b"printer\0").pack(), "foreign-device", "calls itself b'printer'"),
    ],
    ids=["2.0", "3.0", "old firmware", "printer"],
)
def test_another_version_or_make(ident: bytes, code: str, words: str) -> None:
    with device(says(ident)) as port:
        error = refusal(port)
    assert error.code == code
    assert re.search(words, error.message)


def test_something_that_chatters() -> None:
    with device(lambda data: b"$GPGGA,123519,4807.038,N\r\n" * 3) as port:
        error = refusal(port)
    assert error.code == "foreign-device"
    assert "no message of the trigger controller's protocol" in error.message


def test_something_that_says_nothing() -> None:
    with device(lambda data: b"") as port:
        assert refusal(port).code == "controller-silent"


def test_a_port_that_is_not_there(tmp_path: Path) -> None:
    error = refusal(str(tmp_path / "vaoi-trigger"))
    assert error.code == "port-absent"
    assert "71-vaoi-controller.rules" in error.action


def test_a_file_is_no_port(tmp_path: Path) -> None:
    (tmp_path / "file").write_text("")
    assert refusal(str(tmp_path / "file")).code == "port-unusable"


def test_a_port_in_use() -> None:
    """By whoever holds the lock that serial programs agree on."""
    import fcntl

    with device(says(IDENT.pack())) as port:
        handle = os.open(port, os.O_RDWR | os.O_NOCTTY)
        try:
            fcntl.flock(handle, fcntl.LOCK_EX)
            error = refusal(port)
        finally:
            os.close(handle)
    assert error.code == "port-in-use"
    assert "fuser" in error.action


def test_closing_a_port_does_not_reset_the_board_behind_it() -> None:
    """DTR falls at the last closing only if HUPCL is set."""
    with device(lambda data: b"") as name:
        waker = Waker()
        handle = os.open(name, os.O_RDWR | os.O_NOCTTY)
        flags = termios.tcgetattr(handle)
        flags[2] |= termios.HUPCL
        termios.tcsetattr(handle, termios.TCSANOW, flags)
        Port(name, 250_000, waker).close()
        assert not termios.tcgetattr(handle)[2] & termios.HUPCL
        os.close(handle)
        waker.close()


def test_the_udev_rule_makes_the_name_that_is_looked_for() -> None:
    rules = (Path(__file__).resolve().parents[4] / "deploy" / "71-vaoi-controller.rules").read_text()
    name = ControllerConfig().port.removeprefix("/dev/")
    assert f'SYMLINK+="{name}"' in rules
    assert 'ATTR{latency_timer}="1"' in rules
    assert 'ENV{ID_MM_DEVICE_IGNORE}="1"' in rules
