"""Find the running station and read its state by REST. If no station runs, check that its network port is free."""

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
from vaoi_station.doctor.station_connection import address_of, request
from vaoi_station.errors import InputError, VaoiError
from vaoi_station.files.caller_credentials import CallerCredentials

TIMEOUT_S = 3.0
LARGEST_REPLY = 4_000_000


def find(config: StationConfig, credentials: CallerCredentials | None = None) -> RunningProcess | None:
    """Return the process that uses the station's ring, with the state it reports; None if there is no such process."""
    path = ring_path(config)
    owner = read_owner(path)
    hidden = owner is None and nearest(path) == path and not os.access(path, os.R_OK, effective_ids=True)
    if not hidden and (owner is None or not owner[1]):
        return None
    # A ring that exists but cannot be read belongs to another user. Its process may be alive, so the network port is
    # tried.
    pid = owner[0] if owner else None
    try:
        return RunningProcess(pid, snapshot=ask(config.api, credentials))
    except (OSError, http.client.HTTPException, ValueError, VaoiError) as error:
        return RunningProcess(pid, no_reply_reason=f"{type(error).__name__}: {error}")


def ask(api: ApiConfig, credentials: CallerCredentials | None = None) -> dict[str, Any]:
    """Request the state from the station's REST service (`GET station`).

    Raises:
        OSError, HTTPException, ValueError: no station replies at this address.
        InputError: the station asks for a key, or the trusted certificate cannot be used.
    """
    status, content = request(api, "/api/v1/station", TIMEOUT_S, LARGEST_REPLY, credentials)
    document = json.loads(content)
    if status in (http.client.UNAUTHORIZED, http.client.FORBIDDEN):
        raise InputError("the station asks for a key with the scope read; give it with --key-file or VAOI_KEY_FILE")
    if status != http.client.OK or not isinstance(document, dict) or "state" not in document:
        raise ValueError(f"reply {status} is not that of a station")
    return document


def station(context: CheckContext) -> Iterator[Finding]:
    """Report state, reasons and warnings of the running station; if none runs, report whether its port is free."""
    api, running = context.config.api, context.running
    if running is None:
        yield _port(api)
        return
    if running.no_reply_reason:
        yield warning(
            f"{running.description} uses the station's ring, but no station replies at port {api.port} "
            f"({running.no_reply_reason}); it is starting, or it is vaoi record.",
            running.inspect_command,
            code="station-silent",
        )
        return
    snapshot = running.snapshot
    yield ok(
        f"runs as {running.description}, state {snapshot['state']!r}; its devices are not opened",
        figures={"state": str(snapshot["state"])},
    )
    level = fault if snapshot["state"] == "faulted" else warning
    yield from (_from_reason(level, reason) for reason in snapshot.get("reasons", ()))
    yield from (_from_reason(warning, reason) for reason in snapshot.get("warnings", ()))


def _from_reason(level: Callable[..., Finding], reason: dict[str, Any]) -> Finding:
    """Turn a reason or a warning of the station into a finding with the same code, message and action."""
    code = str(reason.get("code"))
    return level(str(reason.get("message")), str(reason.get("action") or ""), subject=code, code=code)


def _port(api: ApiConfig) -> Finding:
    """Check that no other program listens at the address and port of the station's REST service."""
    # Connect instead of bind: to bind the port would take it from a station that starts at this moment.
    address = address_of(api)
    try:
        with socket.create_connection(address, timeout=TIMEOUT_S):
            pass
    except OSError:
        return ok(f"is not running; port {api.port} is free", figures={"port": api.port})
    return fault(
        f"is not running, but another program listens at {address[0]}:{api.port}.",
        f"Find it by ss -ltnp 'sport = :{api.port}' and end it, or set [api] port in station.toml.",
        figures={"port": api.port},
        code="api-port-in-use",
    )
