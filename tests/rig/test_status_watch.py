"""Poll a scripted station and decide since when it is ready."""

from __future__ import annotations

import threading
import time
from collections.abc import Iterator
from typing import Any, cast

import pytest

from vaoi_station.demo.client import Client
from vaoi_station.errors import DeviceError
from vaoi_station.rig import run as status_watch
from vaoi_station.rig.run import StatusWatch, all_connected

TIMEOUT_S = 20.0


class Station:
    """A station whose state the test sets; None: it does not answer."""

    def __init__(self) -> None:
        self.state: str | None = "starting"
        self.connected = [True, True]
        self.polls = threading.Semaphore(0)

    def get(self, path: str) -> dict[str, Any]:
        assert path == "/station"
        self.polls.release()
        if self.state is None:
            raise DeviceError("the station does not answer.")
        return {"state": self.state, "cameras": [{"connected": c} for c in self.connected]}

    def poll_twice(self) -> None:
        """Wait until a poll that began after this call has ended."""
        while self.polls.acquire(blocking=False):
            pass
        for _ in range(2):
            assert self.polls.acquire(timeout=TIMEOUT_S)


@pytest.fixture
def station(monkeypatch: pytest.MonkeyPatch) -> Station:
    monkeypatch.setattr(status_watch, "INTERVAL_S", 0.005)
    return Station()


@pytest.fixture
def watch(station: Station) -> Iterator[StatusWatch]:
    with StatusWatch(cast("Client", station)) as watch:
        yield watch


def test_a_condition_is_checked_on_replies_after_the_call(watch: StatusWatch, station: Station) -> None:
    assert watch.wait(lambda s: s["state"] == "starting", TIMEOUT_S)
    station.state = "idle"
    assert watch.wait(lambda s: s["state"] == "idle", TIMEOUT_S)
    assert watch.last["state"] == "idle"
    assert not watch.wait(lambda s: s["state"] == "starting", 0.05)


def test_ready_means_armed_with_all_cameras(watch: StatusWatch, station: Station) -> None:
    station.state = "armed"
    assert watch.wait_ready(TIMEOUT_S)
    station.connected[1] = False
    assert not watch.wait_ready(0.05)
    station.connected[1] = True
    station.state = "filming"
    assert not watch.wait_ready(0.05)


def test_ready_since_is_the_first_reply_of_an_unbroken_series(watch: StatusWatch, station: Station) -> None:
    began_ns = time.monotonic_ns()
    station.state = "armed"
    assert watch.wait_ready(TIMEOUT_S)
    station.state = "stopped"
    assert watch.wait(lambda s: s["state"] == "stopped", TIMEOUT_S)
    assert watch.ready_since(began_ns) is None
    middle_ns = time.monotonic_ns()
    station.state = "filming"
    assert watch.wait(lambda s: s["state"] == "filming", TIMEOUT_S)
    since_ns = watch.ready_since(began_ns)
    assert since_ns is not None
    assert middle_ns <= since_ns <= time.monotonic_ns()
    assert watch.ready_since(time.monotonic_ns() + 10**12) is None


def test_a_station_that_does_not_answer_changes_nothing(watch: StatusWatch, station: Station) -> None:
    station.state = "armed"
    assert watch.wait_ready(TIMEOUT_S)
    since_ns = watch.ready_since(0)
    station.state = None
    station.poll_twice()
    assert watch.last["state"] == "armed"
    assert watch.ready_since(0) == since_ns


def test_before_the_first_reply_nothing_is_known() -> None:
    assert StatusWatch(cast("Client", Station())).ready_since(0) is None


@pytest.mark.parametrize(("connected", "expected"), [([], True), ([True], True), ([True, False], False)])
def test_all_connected(connected: list[bool], expected: bool) -> None:
    assert all_connected({"cameras": [{"connected": c} for c in connected]}) == expected
