"""The answer to a request whose connection has waited in vain: sent on the bare socket, without a protocol."""

from __future__ import annotations

import socket
from contextlib import suppress
from functools import lru_cache

from vaoi_station.api.problems import problem_response

HEAD_BYTES = 64 * 1024
"""Bytes of a request that are read before it is refused. What is left unread can cost the caller the answer."""
_DETAIL = "This address has as many connections as it may, all of them in use, or it opens new ones too fast."
_ACTION = "Use one connection for many requests, read each answer, and try again in a moment."


def refuse(connected: socket.socket) -> bool:
    """Answer the request that has arrived on a socket with 503, and close the socket; return whether there was one."""
    answered = False
    with suppress(OSError):
        connected.setblocking(False)
        # A socket that is closed with unread bytes resets the connection, and the caller may not see the answer.
        head = connected.recv(HEAD_BYTES)
        method, path = _asked(head)
        if path is not None:
            # One call: a new socket has room for the whole answer.
            connected.send(busy_answer(method, path))
            connected.shutdown(socket.SHUT_WR)
            answered = True
    connected.close()
    return answered


@lru_cache(64)
def busy_answer(method: str, path: str) -> bytes:
    """Return a complete answer of HTTP: 503 with Retry-After and problem details."""
    reply = problem_response({"path": path}, "busy", _DETAIL, action=_ACTION, headers={"Connection": "close"})
    lines = [b"HTTP/1.1 503 Service Unavailable", *(name + b": " + value for name, value in reply.raw_headers)]
    body = b"" if method == "HEAD" else bytes(reply.body)
    return b"\r\n".join([*lines, b"", body])


def _asked(head: bytes) -> tuple[str, str | None]:
    """Return method and path of a request; no path if the bytes do not begin with a request of HTTP."""
    method, _, rest = head.partition(b"\r\n")[0].decode("latin-1").partition(" ")
    target, _, version = rest.partition(" ")
    is_request = target.startswith("/") and version.startswith("HTTP/1.")
    return method, target.partition("?")[0][:300] if is_request else None
