"""Wait until the station is ready, and until a board has been filmed."""

from __future__ import annotations

import time
from collections.abc import Callable
from typing import Any

from vaoi_station.demo.client import Client
from vaoi_station.errors import DeviceError, NotFoundError

POLL_S = 10.0
START_S = 180.0
"""Longest time without progress until the station is ready: workers may have to compile first."""
REPORT_S = 10.0
"""Time, s, between two reports of what a start waits for; a start that is faster is not reported."""
BOARD_S = 180.0
"""Longest time until a board has passed: the twin renders the frames of the board first."""


def wait_until_idle(client: Client, report: Callable[[str], None] = lambda _: None) -> None:
    """Wait on the event stream until the station can be armed, as long as its start makes progress.

    Args:
        client: of the station.
        report: is called every `REPORT_S` with what the station waits for.

    Raises:
        DeviceError: the station is faulted, or its start has made no progress for `START_S`.
    """
    deadline, waits_for, next_report = time.monotonic() + START_S, "", time.monotonic() + REPORT_S
    # Every event wakes the loop, heartbeats too, so no timer is needed.
    for _ in client.messages():
        station = client.get("/station")
        _refuse_fault(station)
        if station["state"] != "starting":
            return
        words = " ".join(f"{w['message']} {w.get('action', '')}".strip() for w in station.get("warnings", ()))
        if words != waits_for:
            # On a slow or busy machine the workers compile for minutes; each inner loop that is compiled is progress.
            deadline, waits_for = time.monotonic() + START_S, words
        if words and time.monotonic() >= next_report:
            next_report = time.monotonic() + REPORT_S
            report(f"The station is starting. {words}")
        if time.monotonic() > deadline:
            break
    raise DeviceError(f"the station is not ready, without progress for {START_S:.0f} s. {waits_for}".strip())


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
