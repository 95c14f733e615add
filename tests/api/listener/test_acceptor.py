"""Floods of connections against a real socket: other callers are served meanwhile."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from typing import Any

import httpx2
import pytest

from vaoi_station.api.listener.http_connection import LimitedHttp

Connect = Callable[..., socket.socket]
HALF = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n"


def test_half_sent_requests_keep_nobody_out(limited: Any, connect: Connect) -> None:
    flood = [connect(HALF) for _ in range(60)]
    for _ in range(5):
        assert httpx2.get(f"{limited.url}/healthz", timeout=20).status_code == 200
    # Most of the flood was closed for those that came after it.
    closed = 0
    for s in flood:
        s.setblocking(False)
        try:
            closed += s.recv(1) == b""
        except ConnectionError:
            closed += 1
        except BlockingIOError:
            pass
    assert closed >= 50


def test_connections_that_send_nothing_keep_nobody_out(limited: Any, connect: Connect) -> None:
    for _ in range(60):
        connect()
    assert httpx2.get(f"{limited.url}/healthz", timeout=20).status_code == 200


def test_bodies_that_never_end_keep_nobody_out(limited: Any, connect: Connect) -> None:
    for _ in range(30):
        connect(b"POST /api/v1/station/disarm HTTP/1.1\r\nHost: localhost\r\nContent-Length: 60000\r\n\r\n{")
    assert httpx2.get(f"{limited.url}/healthz", timeout=20).status_code == 200


def test_a_connection_that_serves_is_kept_through_a_flood(limited: Any, connect: Connect) -> None:
    limited.client.get("/healthz")
    port = connected_port(limited)
    for _ in range(60):
        connect(HALF)
    assert limited.client.get("/healthz").status_code == 200
    assert connected_port(limited) == port


def connected_port(limited: Any) -> int:
    """Return the local port of the client's connection, which a request over it reveals."""
    response = limited.client.get("/healthz")
    stream = response.extensions["network_stream"]
    address: tuple[str, int] = stream.get_extra_info("client_addr")
    return address[1]


def test_an_error_with_one_connection_does_not_end_the_limits_of_others(
    limited: Any, connect: Connect, monkeypatch: pytest.MonkeyPatch
) -> None:
    failed = threading.Event()
    overdue = LimitedHttp.overdue

    def fail_once(http: LimitedHttp) -> bool:
        if not failed.is_set():
            failed.set()
            raise RuntimeError("a fault")
        return overdue(http)

    monkeypatch.setattr(LimitedHttp, "overdue", fail_once)
    waiting = connect(HALF)
    assert failed.wait(20)
    # The limit for the head of a request still holds.
    while waiting.recv(1000):
        pass
