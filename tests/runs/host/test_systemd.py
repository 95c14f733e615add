"""Messages to systemd."""

from __future__ import annotations

import socket
from pathlib import Path

import pytest

from vaoi_station.runs.host.systemd import StatusNotice, notify, notify_watchdog


def test_without_systemd_nothing_is_sent(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.delenv("NOTIFY_SOCKET", raising=False)
    assert notify("READY=1") is False


@pytest.mark.parametrize("abstract", [False, True])
def test_messages_arrive(monkeypatch: pytest.MonkeyPatch, tmp_path: Path, abstract: bool) -> None:
    address = f"@vaoi-test-{tmp_path.name}" if abstract else str(tmp_path / "notify")
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind("\0" + address[1:] if abstract else address)
        systemd.settimeout(10)
        monkeypatch.setenv("NOTIFY_SOCKET", address)
        assert notify("READY=1")
        notify_watchdog()
        assert systemd.recv(100) == b"READY=1"
        assert systemd.recv(100) == b"WATCHDOG=1"


def test_a_missing_socket_is_no_error(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    monkeypatch.setenv("NOTIFY_SOCKET", str(tmp_path / "missing"))
    assert notify("READY=1") is False


def test_a_status_is_sent_when_it_changes(monkeypatch: pytest.MonkeyPatch, tmp_path: Path) -> None:
    address = str(tmp_path / "notify")
    show = StatusNotice()
    show("not delivered")  # so that it is sent again once systemd listens
    with socket.socket(socket.AF_UNIX, socket.SOCK_DGRAM) as systemd:
        systemd.bind(address)
        systemd.settimeout(10)
        monkeypatch.setenv("NOTIFY_SOCKET", address)
        for status in ("not delivered", "armed", "armed", "idle\nsecond line"):
            show(status)
        notify("STOPPING=1")
        received = [systemd.recv(100) for _ in range(4)]
    assert received == [b"STATUS=not delivered", b"STATUS=armed", b"STATUS=idle", b"STOPPING=1"]
