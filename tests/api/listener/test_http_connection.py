"""The times that a connection has for its request and its answer, with a real socket."""

from __future__ import annotations

import socket
import threading
from collections.abc import Callable
from typing import Any

import pytest

Connect = Callable[..., socket.socket]
REQUEST = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\n\r\n"


def until_closed(s: socket.socket) -> bytes:
    """Read until the station closes the connection."""
    received = bytearray()
    try:
        while got := s.recv(65536):
            received += got
    except ConnectionResetError:
        pass
    return bytes(received)


@pytest.mark.parametrize("sent", [b"", b"GET /healthz HTTP/1.1\r\n", REQUEST, REQUEST + b"GET"])
def test_a_connection_without_a_request_is_closed(connect: Connect, sent: bytes) -> None:
    answer = until_closed(connect(sent))
    assert (b"200 OK" in answer) == (REQUEST in sent)


def test_single_bytes_of_a_head_do_not_keep_a_connection_open(connect: Connect) -> None:
    s, closed = connect(REQUEST + b"GET /"), threading.Event()

    def trickle() -> None:
        # Each byte ends the time-out for idle connections, which uvicorn starts after an answer.
        while not closed.wait(0.1):
            try:
                s.send(b"a")
            except OSError:
                return

    thread = threading.Thread(target=trickle)
    thread.start()
    assert b"200 OK" in until_closed(s)
    closed.set()
    thread.join()


def test_the_rest_of_an_unread_body_does_not_keep_a_connection_open(connect: Connect) -> None:
    head = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nContent-Length: 1000000\r\n\r\n"
    assert b"200 OK" in until_closed(connect(head))


def test_a_caller_that_does_not_read_is_disconnected(limited: Any, connect: Connect) -> None:
    limited.app.get("/large")(lambda: "x" * 8_000_000)
    s = connect(b"GET /large HTTP/1.1\r\nHost: localhost\r\n\r\n", receive_bytes=4096)
    assert s.recv(1) == b"H"
    until_free(limited)
    assert len(until_closed(s)) < 8_000_000


def test_a_caller_that_reads_slowly_is_disconnected_in_the_end(limited: Any, connect: Connect) -> None:
    limited.app.get("/large")(lambda: "x" * 8_000_000)
    s = connect(b"GET /large HTTP/1.1\r\nHost: localhost\r\n\r\n", receive_bytes=4096)
    received, pause = 0, threading.Event()
    try:
        while got := s.recv(40_000):
            received += len(got)
            pause.wait(0.05)
    except ConnectionResetError:
        pass
    assert received < 8_000_000


def test_bytes_that_are_no_request_are_refused(connect: Connect) -> None:
    assert until_closed(connect(b"\x16\x03\x01\x02\x00\x01\r\n\r\n")).startswith(b"HTTP/1.1 400")


def test_bytes_that_are_no_request_behind_a_request_end_the_connection(limited: Any, connect: Connect) -> None:
    poll = b"GET /api/v1/runs/next?timeout=20 HTTP/1.1\r\nHost: localhost\r\n\r\n"
    s = connect(poll + b"\x00\x01\r\n\r\n")
    limited.station.film()
    until_closed(s)
    assert limited.client.get("/healthz").status_code == 200


def until_free(limited: Any) -> None:
    """Wait until no connection but the one of this request is open."""
    state = limited._server._server.server_state
    while len(state.connections) > 1:
        limited.client.get("/healthz")
