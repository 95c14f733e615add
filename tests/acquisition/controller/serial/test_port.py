"""A serial port over a pseudo terminal: waking, hanging up, and what happens to DTR."""

from __future__ import annotations

import fcntl
import os
import termios
import threading
import tty
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path

import pytest

from vaoi_station.acquisition.controller.serial import exchange as port_module
from vaoi_station.acquisition.controller.serial.exchange import Port, Waker
from vaoi_station.config import ControllerConfig
from vaoi_station.errors import DeviceError


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


def test_bytes_arrive_as_they_were_sent(terminal: tuple[int, str], waker: Waker) -> None:
    with closing(Port(terminal[1], 250_000, waker)) as port:
        os.write(terminal[0], bytes(range(256)))
        received = b""
        while len(received) < 256:
            received += port.read(5.0)
        assert received == bytes(range(256))
        assert port.received == 256
        port.write(b"\0\1\2\xff")
        assert os.read(terminal[0], 100) == b"\0\1\2\xff"


def test_a_read_ends_without_bytes(terminal: tuple[int, str], waker: Waker) -> None:
    with closing(Port(terminal[1], 250_000, waker)) as port:
        assert port.read(0.001) == b""


def test_another_thread_ends_a_read(terminal: tuple[int, str], waker: Waker) -> None:
    with closing(Port(terminal[1], 250_000, waker)) as port:
        timer = threading.Timer(0.01, waker.wake)
        timer.start()
        assert port.read(60.0) == b""
        timer.join()
        assert port.read(0.001) == b"", "the wake-up is used up"


def test_a_wake_up_before_the_read_ends_it_too(terminal: tuple[int, str], waker: Waker) -> None:
    with closing(Port(terminal[1], 250_000, waker)) as port:
        for _ in range(100_000):  # more than the pipe holds
            waker.wake()
        assert port.read(60.0) == b""


def test_a_device_that_hangs_up_is_an_error(waker: Waker) -> None:
    ours, theirs = os.openpty()
    tty.setraw(theirs)
    name = os.ttyname(theirs)
    os.close(theirs)
    with closing(Port(name, 250_000, waker)) as port:
        os.close(ours)
        with pytest.raises(OSError, match=r"hung up|Input/output error"):
            port.read(5.0)


def test_a_port_that_takes_no_bytes_is_an_error(
    terminal: tuple[int, str], waker: Waker, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(port_module, "WRITE_S", 0.01)
    with closing(Port(terminal[1], 250_000, waker)) as port, pytest.raises(OSError, match="takes no bytes"):
        port.write(bytes(1 << 20))  # more than a terminal's buffer holds


def test_a_port_that_is_not_there(tmp_path: Path, waker: Waker) -> None:
    with pytest.raises(DeviceError) as refused:
        Port(str(tmp_path / "vaoi-trigger"), 250_000, waker)
    assert refused.value.code == "port-absent"
    assert "71-vaoi-controller.rules" in refused.value.action


def test_a_file_is_no_port(tmp_path: Path, waker: Waker) -> None:
    (tmp_path / "file").write_text("")
    with pytest.raises(DeviceError) as refused:
        Port(str(tmp_path / "file"), 250_000, waker)
    assert refused.value.code == "port-unusable"


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


def test_the_udev_rule_makes_the_name_that_is_opened_by_default() -> None:
    rules = (Path(__file__).resolve().parents[4] / "deploy" / "71-vaoi-controller.rules").read_text()
    name = ControllerConfig().port.removeprefix("/dev/")
    assert f'SYMLINK+="{name}"' in rules
    assert 'ATTR{latency_timer}="1"' in rules
    assert 'ENV{ID_MM_DEVICE_IGNORE}="1"' in rules
