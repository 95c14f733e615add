"""Poll the station's status four times a second, and wait for conditions on it."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable
from typing import Any

from vaoi_station.demo.client import Client
from vaoi_station.errors import DeviceError

INTERVAL_S = 0.25
_READY = ("armed", "filming")


class StatusWatch:
    """Watch of the station's status, as a context manager. A thread requests the status and keeps the replies."""

    def __init__(self, client: Client) -> None:
        self._client = client
        self._closing = threading.Event()
        self._change = threading.Condition()
        self._states: list[tuple[int, bool]] = []
        """(time, ready) of each reply: ns of CLOCK_MONOTONIC, and whether the station was ready with all cameras."""
        self._requested_ns = 0
        self.last: dict[str, Any] = {}
        """JSON of the last reply to `GET station`."""
        self._thread = threading.Thread(target=self._poll, name="status watch")

    def __enter__(self) -> StatusWatch:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self._thread.join()

    def wait(self, condition: Callable[[dict[str, Any]], bool], timeout_s: float) -> bool:
        """Wait until a status requested after this call meets a condition. Return False after the timeout."""
        now_ns = time.monotonic_ns()
        with self._change:
            # Older replies do not count, because they may describe the state before the fault whose end is awaited.
            return self._change.wait_for(lambda: self._requested_ns >= now_ns and condition(self.last), timeout_s)

    def wait_ready(self, timeout_s: float) -> bool:
        """Wait until the station is armed and all its cameras are connected. Return False after the timeout."""
        return self.wait(lambda station: station["state"] == "armed" and all_connected(station), timeout_s)

    def ready_since(self, after_ns: int) -> int | None:
        """Return the time since which the station has been ready without a break; None if it is not ready now.

        Args:
            after_ns: time before which replies do not count. Both times are ns of CLOCK_MONOTONIC.
        """
        with self._change:
            states = [(when, ready) for when, ready in self._states if when >= after_ns]
        if not states or not states[-1][1]:
            return None
        first = len(states) - 1
        while first and states[first - 1][1]:
            first -= 1
        return states[first][0]

    def _poll(self) -> None:
        while not self._closing.wait(INTERVAL_S):
            requested_ns = time.monotonic_ns()
            try:
                station = self._client.get("/station")
            # A stopped or ending service does not reply. A missing reply gives no state.
            except DeviceError:  # the service is stopped or ending
                continue
            ready = station["state"] in _READY and all_connected(station)
            with self._change:
                self._requested_ns = requested_ns
                self._states.append((time.monotonic_ns(), ready))
                self.last = station
                self._change.notify_all()


def all_connected(station: dict[str, Any]) -> bool:
    """Whether all cameras are connected; `station` is the JSON of `GET station`."""
    return all(camera["connected"] for camera in station["cameras"])
