"""What the station says of itself, four times a second."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from vaoi_station.demo.client import Client
from vaoi_station.errors import DeviceError

EVERY_S = 0.25
_READY = ("armed", "filming")


class Watch:
    """A thread of its own; a context manager."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._closing = threading.Event()
        self._change = threading.Condition()
        self._seen: list[tuple[int, bool]] = []
        """CLOCK_MONOTONIC of an answer, and whether the station was ready with all its cameras."""
        self._asked_ns = 0
        self.last: dict[str, Any] = {}
        self._thread = threading.Thread(target=self._work, name="watch")

    def __enter__(self) -> Watch:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self._thread.join()

    def wait(self, true: Callable[[dict[str, Any]], bool], timeout_s: float) -> bool:
        """Until the station, asked from now on, says something of itself that is so."""
        now_ns = time.monotonic_ns()
        with self._change:
            return self._change.wait_for(lambda: self._asked_ns >= now_ns and true(self.last), timeout_s)

    def wait_ready(self, timeout_s: float) -> bool:
        """Until it takes boards, with all its cameras."""
        return self.wait(lambda station: station["state"] == "armed" and all_there(station), timeout_s)

    def ready_since(self, after_ns: int) -> int | None:
        """CLOCK_MONOTONIC of the first answer behind the last one that was not ready; None if it is not ready now.

        Args:
            after_ns: answers before this time do not count.
        """
        with self._change:
            seen = [(when, ready) for when, ready in self._seen if when >= after_ns]
        if not seen or not seen[-1][1]:
            return None
        first = len(seen) - 1
        while first and seen[first - 1][1]:
            first -= 1
        return seen[first][0]

    def _work(self) -> None:
        while not self._closing.wait(EVERY_S):
            asked_ns = time.monotonic_ns()
            try:
                station = self._client.get("/station")
            except DeviceError:  # it is being stopped, or has been
                continue
            ready = station["state"] in _READY and all_there(station)
            with self._change:
                self._asked_ns = asked_ns
                self._seen.append((time.monotonic_ns(), ready))
                self.last = station
                self._change.notify_all()


def all_there(station: dict[str, Any]) -> bool:
    """Whether all cameras are connected."""
    return all(camera["connected"] for camera in station["cameras"])
