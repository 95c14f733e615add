"""The service's process: its start, its failures, its end."""

from __future__ import annotations

import signal
from pathlib import Path

import pytest

from vaoi_station.demo.service import Service
from vaoi_station.demo.signal_handling import interruptible
from vaoi_station.errors import DeviceError


def test_a_service_that_cannot_start_says_why(tmp_path: Path) -> None:
    service = Service(tmp_path / "station.toml")
    with pytest.raises(DeviceError, match=r"did not start: .*station.toml: there is no such file"), service:
        pass
    assert not Path(f"/proc/{service.pid}").exists()


def test_the_first_signal_interrupts_and_later_ones_do_not() -> None:
    before = signal.getsignal(signal.SIGTERM)
    told: list[str] = []

    def work() -> None:
        try:
            signal.raise_signal(signal.SIGTERM)
        finally:
            signal.raise_signal(signal.SIGINT)
            signal.raise_signal(signal.SIGTERM)
            told.append("put away")

    with pytest.raises(KeyboardInterrupt, match="SIGTERM"), interruptible():
        work()
    assert told == ["put away"]
    assert signal.getsignal(signal.SIGTERM) is before
