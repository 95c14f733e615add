"""Floods of connections against a real socket: other callers are served meanwhile."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Callable, Iterator
from contextlib import suppress
from dataclasses import replace
from typing import Any

import httpx2
import pytest

from vaoi_station.api.listener.connections import ConnectionLimits
from vaoi_station.api.listener.http_connection import LimitedHttp

Connect = Callable[..., socket.socket]
HALF = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n"
CLOSING = HALF + b"Connection: close\r\n\r\n"


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


ONE_PLACE = ConnectionLimits(
    per_address=1, exchanges=3, exchanges_per_s=1e-6, waiting_per_address=2, wait_s=0.2, refused=5
)
"""Limits with which a caller may exchange its connection three times, and then hardly ever again."""


@pytest.fixture
def braked(station: Any, serve: Any) -> Iterator[Any]:
    server = serve(station, limits=ONE_PLACE)
    server.client.close()
    yield server
    server.stop()


def asked_from(address: str, port: int, sent: bytes) -> socket.socket:
    """Open a connection from an address of loopback, and send a request on it."""
    s = socket.create_connection(("127.0.0.1", port), 20, (address, 0))
    s.sendall(sent)
    return s


def received(s: socket.socket) -> bytes:
    """Read what a connection receives until it is closed."""
    parts = []
    with s, suppress(ConnectionError):
        while part := s.recv(65536):
            parts.append(part)
    return b"".join(parts)


def test_a_caller_exchanges_a_bounded_number_of_connections(braked: Any) -> None:
    """Each exchange costs a request that is begun; what comes beyond waits for a moment, and is refused."""
    flood, answers = [], []
    for _ in range(8):
        # Each is idle after its answer, so that it gives way to the next one.
        flood.append(asked_from("127.0.0.66", braked.port, HALF + b"\r\n"))
        answers.append(flood[-1].recv(12))
    assert answers == [b"HTTP/1.1 200"] * (1 + ONE_PLACE.exchanges) + [b"HTTP/1.1 503"] * 4
    for s in flood:
        s.close()


def test_other_callers_are_served_during_a_flood(braked: Any) -> None:
    flood = [asked_from("127.0.0.66", braked.port, HALF) for _ in range(50)]
    answer = received(asked_from("127.0.0.1", braked.port, CLOSING))
    assert answer.startswith(b"HTTP/1.1 200")
    for s in flood:
        s.close()


def polling(server: Any) -> socket.socket:
    """Return the only connection of a caller, when its request is under way."""
    poll = b"GET /api/v1/runs/next?timeout=60 HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
    s, pause = asked_from("127.0.0.66", server.port, poll), threading.Event()
    while not server.app.state.hub.waiting:
        pause.wait(0.005)
    return s


def test_a_caller_that_waits_in_vain_learns_when_to_try_again(braked: Any) -> None:
    with polling(braked):
        answer = received(asked_from("127.0.0.66", braked.port, CLOSING))
    head, _, body = answer.partition(b"\r\n\r\n")
    assert head.startswith(b"HTTP/1.1 503")
    assert b"retry-after: 1" in head
    assert json.loads(body)["code"] == "busy"


def test_a_connection_that_waits_is_served_when_another_one_ends(station: Any, serve: Any) -> None:
    server = serve(station, limits=replace(ONE_PLACE, wait_s=60.0))
    server.client.close()
    first = polling(server)
    second = asked_from("127.0.0.66", server.port, CLOSING)
    server.station.film()
    assert received(first).startswith(b"HTTP/1.1 200")
    assert received(second).startswith(b"HTTP/1.1 200")
    server.stop()


def test_a_connection_that_was_closed_while_it_waited_takes_no_turn_of_others(station: Any, serve: Any) -> None:
    """Otherwise a program at the same address would wait for all that a flood has given up."""
    server = serve(station, limits=replace(ONE_PLACE, waiting_per_address=20, wait_s=60.0))
    server.client.close()
    first = polling(server)
    for _ in range(10):
        asked_from("127.0.0.66", server.port, HALF).close()
    last = asked_from("127.0.0.66", server.port, CLOSING)
    server.station.film()
    assert received(first).startswith(b"HTTP/1.1 200")
    assert received(last).startswith(b"HTTP/1.1 200")
    server.stop()


@pytest.mark.parametrize(("young_s", "answer"), [(60.0, b"HTTP/1.1 503"), (0.0, b"HTTP/1.1 200")])
def test_a_new_connection_keeps_its_place_for_a_moment(station: Any, serve: Any, young_s: float, answer: bytes) -> None:
    """Its request may be on its way: otherwise connections in a flood end before the station has read it."""
    server = serve(station, limits=replace(ONE_PLACE, young_s=young_s))
    server.client.close()
    with asked_from("127.0.0.66", server.port, HALF):
        assert received(asked_from("127.0.0.66", server.port, CLOSING)).startswith(answer)
    server.stop()


def test_callers_beyond_those_that_wait_are_answered_within_limits(station: Any, serve: Any) -> None:
    server = serve(station, limits=replace(ONE_PLACE, waiting_per_address=1, wait_s=60.0))
    server.client.close()
    with polling(server), asked_from("127.0.0.66", server.port, CLOSING):
        refused = [received(asked_from("127.0.0.66", server.port, CLOSING)) for _ in range(20)]
    server.stop()
    assert all(answer.startswith(b"HTTP/1.1 503") for answer in refused)
