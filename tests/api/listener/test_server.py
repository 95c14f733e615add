"""The server on its limited listener: the time of answers on a connection that is used again."""

from __future__ import annotations

import socket
import time
from statistics import median
from typing import Any

REQUEST = b"GET /web/icon.svg HTTP/1.1\r\nHost: localhost\r\n\r\n"


def exchange(s: socket.socket) -> float:
    """Send one request, read the whole answer, and return the time in s."""
    begun = time.perf_counter()
    s.sendall(REQUEST)
    received = b""
    while b"\r\n\r\n" not in received:
        received += s.recv(65536)
    head, _, body = received.partition(b"\r\n\r\n")
    length = int(head.lower().partition(b"content-length: ")[2].partition(b"\r\n")[0])
    while len(body) < length:
        body += s.recv(65536)
    return time.perf_counter() - begun


def test_an_answer_on_a_kept_alive_connection_takes_no_longer_than_on_a_new_one(served: Any) -> None:
    """With Nagle's algorithm it takes 40 ms, in which the caller's kernel delays its acknowledgement."""
    fresh, kept = [], []
    for _ in range(15):
        with socket.create_connection(("127.0.0.1", served.port), 20) as s:
            fresh.append(exchange(s))
    with socket.create_connection(("127.0.0.1", served.port), 20) as s:
        kept = [exchange(s) for _ in range(30)][10:]
    assert median(kept) < 5 * median(fresh)


def test_addresses_in_headers_are_not_believed(served: Any) -> None:
    seen: list[Any] = []

    async def note(scope: Any, receive: Any, send: Any) -> None:
        seen.append(scope["client"][0])
        await inner(scope, receive, send)

    inner, served.app.middleware_stack = served.app.middleware_stack, note
    served.client.get("/healthz", headers={"x-forwarded-for": "192.0.2.1"})
    assert seen == ["127.0.0.1"]
