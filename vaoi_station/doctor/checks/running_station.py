"""Does the station run? Then cameras and controller are its own, and it is asked what it thinks of them."""

from __future__ import annotations

import http.client
import json
import os
import socket
from collections.abc import Callable, Iterator
from typing import Any

from vaoi_station.acquisition.ring.ring import ring_path
from vaoi_station.acquisition.ring.ring_file import read_owner
from vaoi_station.config import ApiConfig, StationConfig
from vaoi_station.doctor.check_context import CheckContext, RunningProcess
from vaoi_station.doctor.finding import Finding, fault, ok, warning
from vaoi_station.doctor.machine import nearest

TIMEOUT_S = 3.0
LARGEST_ANSWER = 4_000_000
_EVERYWHERE = {"0.0.0.0": "127.0.0.1", "::": "::1", "": "127.0.0.1"}  # noqa: S104  (to be asked, not listened on)


def find(config: StationConfig) -> RunningProcess | None:
    """The owner of the station's ring, if it lives, and what it says."""
    path = ring_path(config)
    owner = read_owner(path)
    hidden = owner is None and nearest(path) == path and not os.access(path, os.R_OK, effective_ids=True)
    if not hidden and (owner is None or not owner[1]):
        return None
    pid = owner[0] if owner else None
    try:
        return RunningProcess(pid, snapshot=ask(config.api))
    except (OSError, http.client.HTTPException, ValueError) as error:
        return RunningProcess(pid, no_reply_reason=f"{type(error).__name__}: {error}")


def ask(api: ApiConfig) -> dict[str, Any]:
    """GET station; OSError, HTTPException or ValueError where no station answers."""
    connection = http.client.HTTPConnection(_EVERYWHERE.get(api.host, api.host), api.port, timeout=TIMEOUT_S)
    try:
        connection.request("GET", "/api/v1/station")
        answer = connection.getresponse()
        document = json.loads(answer.read(LARGEST_ANSWER))
    finally:
        connection.close()
    if answer.status != http.client.OK or not isinstance(document, dict) or "state" not in document:
        raise ValueError(f"answer {answer.status} is not that of a station")
    return document


def station(context: CheckContext) -> Iterator[Finding]:
    """Its state and what it complains of; or whether its port is free."""
    api, running = context.config.api, context.running
    if running is None:
        yield _port(api)
        return
    if running.no_reply_reason:
        yield warning(
            f"{running.description} uses the station's memory, but no station answers at port {api.port} "
            f"({running.no_reply_reason}); it may be starting, or be vaoi record or vaoi view.",
            running.inspect_command,
        )
        return
    told = running.snapshot
    yield ok(
        f"runs as {running.description}, state {told['state']!r}; it is asked and left alone",
        figures={"state": str(told["state"])},
    )
    grave = fault if told["state"] == "faulted" else warning
    yield from (_complaint(grave, reason) for reason in told.get("reasons", ()))
    yield from (_complaint(warning, reason) for reason in told.get("warnings", ()))


def _complaint(level: Callable[..., Finding], reason: dict[str, Any]) -> Finding:
    """A reason of the station's, in its own words."""
    return level(str(reason.get("message")), str(reason.get("action") or ""), subject=str(reason.get("code")))


def _port(api: ApiConfig) -> Finding:
    """Nobody but a station may have its port; found out by asking, not by taking it."""
    address = (_EVERYWHERE.get(api.host, api.host), api.port)
    try:
        with socket.create_connection(address, timeout=TIMEOUT_S):
            pass
    except OSError:
        return ok(f"does not run; port {api.port} is free", figures={"port": api.port})
    return fault(
        f"does not run, but another program listens at {address[0]}:{api.port}.",
        f"ss -ltnp 'sport = :{api.port}' names it; end it, or set [api] port.",
        figures={"port": api.port},
    )
