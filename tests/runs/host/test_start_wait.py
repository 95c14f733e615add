"""Starts that fail at first, with causes that pass and causes that do not."""

from __future__ import annotations

import pytest

from vaoi_station.errors import DeviceError, InputError, VaoiError
from vaoi_station.runs.host import start_wait as module
from vaoi_station.runs.host.start_wait import PASSING, StartWait
from vaoi_station.runs.host.stop_request import StopRequest


@pytest.fixture(autouse=True)
def _short(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "FIRST_PAUSE_S", 0.01)


@pytest.mark.parametrize("code", sorted(PASSING))
def test_a_cause_that_passes_is_waited_for_and_reported(code: str) -> None:
    faults, reported = [DeviceError("not yet", code=code) for _ in range(3)], list[VaoiError]()
    waiting = faults.copy()

    def start() -> str:
        if waiting:
            raise waiting.pop(0)
        return "started"

    with StopRequest() as stop:
        assert StartWait(stop).until_started(start, reported.append) == "started"
    assert reported == faults


def test_a_cause_that_does_not_pass_ends_the_start_at_once() -> None:
    def start() -> None:
        raise InputError("station.toml: a typing error")

    with StopRequest() as stop, pytest.raises(InputError, match="typing error"):
        StartWait(stop).until_started(start, lambda _: pytest.fail("nothing to wait for"))


def test_a_request_to_stop_ends_the_wait() -> None:
    def start() -> int:
        raise DeviceError("full", code="storage-full")

    with StopRequest() as stop:
        assert StartWait(stop).until_started(start, lambda _: stop.request()) is None
