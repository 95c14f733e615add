"""Waiting for the station: until it is ready, until a board has been filmed."""

from __future__ import annotations

import time
from typing import Any

from vaoi_station.demo.client import Client
from vaoi_station.errors import DeviceError, NotFoundError

POLL_S = 10.0
START_S = 180.0
"""For workers to compile, when they are first started, and for the twin to open: it draws its board first."""
BOARD_S = 180.0
"""For a board to come and pass: its frames are rendered first."""


def wait_until_idle(client: Client) -> None:
    """Wait on the event stream until the station can be armed.

    Raises:
        DeviceError: it is faulted, or takes too long.
    """
    deadline = time.monotonic() + START_S
    for _ in client.messages():
        station = client.get("/station")
        _refuse_fault(station)
        if station["state"] != "starting":
            return
        if time.monotonic() > deadline:
            break
    raise DeviceError(f"the station is not ready after {START_S:.0f} s.")


def wait_for_run(client: Client, after: str | None) -> dict[str, Any]:
    """The first run that finished after `after` (None: the first of all), by long poll.

    Raises:
        DeviceError: the station is faulted, or no board comes.
    """
    deadline = time.monotonic() + BOARD_S
    while time.monotonic() < deadline:
        if (run := poll(client, after)) is not None:
            return run
        _refuse_fault(client.get("/station"))
    raise DeviceError(f"no board was filmed within {BOARD_S:.0f} s.")


def poll(client: Client, after: str | None) -> dict[str, Any] | None:
    """The same, with patience for one poll: None if no run has finished meanwhile."""
    run = client.get("/runs/next", after=after, timeout=POLL_S)
    if run is None and after is None:
        run = _latest(client)
    return None if run is None else dict(run)


def _latest(client: Client) -> Any:
    """A first run that ended before anybody waited for it."""
    try:
        return client.get("/runs/latest")
    except NotFoundError:
        return None


def _refuse_fault(station: dict[str, Any]) -> None:
    if station["state"] == "faulted":
        words = " ".join(f"{r['message']} {r.get('action', '')}" for r in station["reasons"])
        raise DeviceError(f"the station is faulted. {words}".strip())
