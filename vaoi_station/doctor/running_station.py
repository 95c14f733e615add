"""The station that runs on this machine: found by its ring, and asked by REST; the input of every check."""

from __future__ import annotations

import http.client
import json
import os
import socket
import ssl
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import cached_property
from typing import Any

from vaoi_station.acquisition.ring import RingLayout, read_owner, ring_path
from vaoi_station.config import ApiConfig, CameraConfig, StationConfig
from vaoi_station.doctor.finding import Finding, fault, ok, warning
from vaoi_station.doctor.machine import Machine, nearest
from vaoi_station.errors import InputError, VaoiError
from vaoi_station.files.caller_credentials import CallerCredentials


@dataclass(frozen=True)
class RunningProcess:
    """The process that runs on the station's ring now: `vaoi serve` or `vaoi record`."""

    pid: int | None
    """Process id; None if the process belongs to another user and cannot be inspected."""
    snapshot: dict[str, Any] = field(default_factory=dict)
    """The station's reply to GET station; empty if it did not reply."""
    no_reply_reason: str = ""

    @property
    def description(self) -> str:
        """The name of the process in a finding, for example "process 812"."""
        return "a process of another user" if self.pid is None else f"process {self.pid}"

    @property
    def inspect_command(self) -> str:
        """The shell command with which a reader can identify the process."""
        return "vaoi doctor …, as root" if self.pid is None else f"ps -fp {self.pid}"


@dataclass(frozen=True)
class CheckContext:
    """The input of every check: configuration, machine, and the process that already runs this station, if any."""

    config: StationConfig
    machine: Machine
    running: RunningProcess | None

    @property
    def layout(self) -> RingLayout:
        """The layout of the ring (its sizes in bytes) that this configuration needs."""
        return RingLayout.of(self.config)

    @cached_property
    def real_cameras(self) -> tuple[CameraConfig, ...]:
        """The cameras that are real devices, not simulated or replayed ones."""
        return tuple(camera for camera in self.config.cameras if camera.backend == "aravis")


_EVERYWHERE = {"0.0.0.0": "127.0.0.1", "::": "::1", "": "127.0.0.1"}  # noqa: S104  (an address to connect to, not to listen on)
_PIECE = 256 * 1024


def address_of(api: ApiConfig) -> tuple[str, int]:
    """Return host and port at which a station on this machine can be reached."""
    return _EVERYWHERE.get(api.host, api.host), api.port


def request(
    api: ApiConfig,
    path: str,
    timeout_s: float,
    most_bytes: int,
    credentials: CallerCredentials | None = None,
    complete: Callable[[bytes], bool] = lambda _: False,
) -> tuple[int, bytes]:
    """Send GET to the station; return the status and the reply.

    Of the reply at most about `most_bytes` are read. Reading ends early after `timeout_s`, or when `complete` is true
    of what was read: the stream of events has no end.
    """
    credentials = credentials or CallerCredentials()
    if api.certificate is None:
        connection = http.client.HTTPConnection(*address_of(api), timeout=timeout_s)
    else:
        context = _context(api, credentials)
        connection = http.client.HTTPSConnection(*address_of(api), timeout=timeout_s, context=context)
    try:
        connection.request("GET", path, headers=credentials.headers())
        reply = connection.getresponse()
        # Any program may listen at this port: the length that is read is bounded, and the time.
        content, end = bytearray(), time.monotonic() + timeout_s
        while len(content) < most_bytes and time.monotonic() < end and (piece := reply.read1(_PIECE)):
            content += piece
            if complete(bytes(content)):
                break
        return reply.status, bytes(content)
    finally:
        connection.close()


def _context(api: ApiConfig, credentials: CallerCredentials) -> ssl.SSLContext:
    """Return TLS settings that trust the certificate in the configuration, whatever host name it was made for."""
    if credentials.ca is not None:
        return credentials.tls_context()
    context = CallerCredentials(ca=api.certificate).tls_context()
    # The file holds the certificate of this very station, so that its name says nothing more: it is mostly that of the
    # network, and here the address is loopback.
    context.check_hostname = False
    return context


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
    """Request the state; OSError, HTTPException or ValueError without a station, InputError without a key."""
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
            "station-silent",
            f"{running.description} uses the station's ring, but no station replies at port {api.port} "
            f"({running.no_reply_reason}); it is starting, or it is vaoi record.",
            running.inspect_command,
        )
        return
    snapshot = running.snapshot
    yield ok(
        f"runs as {running.description}, state {snapshot['state']!r}; its devices are not opened",
        state=str(snapshot["state"]),
    )
    level = fault if snapshot["state"] == "faulted" else warning
    yield from (_from_reason(level, reason) for reason in snapshot.get("reasons", ()))
    yield from (_from_reason(warning, reason) for reason in snapshot.get("warnings", ()))


def _from_reason(level: Callable[..., Finding], reason: dict[str, Any]) -> Finding:
    code = str(reason.get("code"))
    return level(code, str(reason.get("message")), str(reason.get("action") or ""), code)


def _port(api: ApiConfig) -> Finding:
    # Connect instead of bind: to bind the port would take it from a station that starts at this moment.
    address = address_of(api)
    try:
        with socket.create_connection(address, timeout=TIMEOUT_S):
            pass
    except OSError:
        return ok(f"is not running; port {api.port} is free", port=api.port)
    return fault(
        "api-port-in-use",
        f"is not running, but another program listens at {address[0]}:{api.port}.",
        f"Find it by ss -ltnp 'sport = :{api.port}' and end it, or set [api] port in station.toml.",
        port=api.port,
    )
