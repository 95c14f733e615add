"""Wait until the station is ready, and until a board has been filmed."""

from __future__ import annotations

import time
from typing import Any

from vaoi_station.demo.client import Client
from vaoi_station.errors import DeviceError, NotFoundError

POLL_S = 10.0
START_S = 180.0
"""Longest time until the station is ready: workers may have to compile first, and the twin draws its board."""
BOARD_S = 180.0
"""Longest time until a board has passed: the twin renders the frames of the board first."""


def wait_until_idle(client: Client) -> None:
    """Wait on the event stream until the station can be armed.

    Raises:
        DeviceError: the station is faulted, or is not ready in time.
    """
    deadline = time.monotonic() + START_S
    # Every event wakes the loop, heartbeats too, so no timer is needed.
    for _ in client.messages():
        station = client.get("/station")
        _refuse_fault(station)
        if station["state"] != "starting":
            return
        if time.monotonic() > deadline:
            break
    raise DeviceError(f"the station is not ready after {START_S:.0f} s.")


def wait_for_run(client: Client, after: str | None) -> dict[str, Any]:
    """Wait for the first run that finishes after the run `after` (None: for the first of all), by long poll.

    Raises:
        DeviceError: the station is faulted, or no board passes in time.
    """
    deadline = time.monotonic() + BOARD_S
    while time.monotonic() < deadline:
        if (run := poll(client, after)) is not None:
            return run
        _refuse_fault(client.get("/station"))
    raise DeviceError(f"no board was filmed within {BOARD_S:.0f} s.")


def poll(client: Client, after: str | None) -> dict[str, Any] | None:
    """Wait by one long poll for the first run after the run `after`. Return None if no run finishes in time."""
    run = client.get("/runs/next", after=after, timeout=POLL_S)
    if run is None and after is None:
        run = _latest(client)
    return None if run is None else dict(run)


def _latest(client: Client) -> Any:
    """Return the latest run, which may have finished before the first poll began, so that no poll returns it."""
    try:
        return client.get("/runs/latest")
    except NotFoundError:
        return None


def _refuse_fault(station: dict[str, Any]) -> None:
    if station["state"] == "faulted":
        words = " ".join(f"{r['message']} {r.get('action', '')}" for r in station["reasons"])
        raise DeviceError(f"the station is faulted. {words}".strip())
