"""The answer to a request on a bare socket."""

from __future__ import annotations

import json
import socket
from collections.abc import Callable, Iterator
from http.client import HTTPResponse

import pytest

from vaoi_station.api.listener.refusal import refuse
from vaoi_station.api.problems import Problem

Refused = Callable[[bytes], socket.socket]


@pytest.fixture
def refused() -> Iterator[Refused]:
    """Return a function that sends bytes on a connection that is then refused, and returns the caller's end of it."""
    opened: list[socket.socket] = []
    with socket.create_server(("127.0.0.1", 0)) as listener:

        def send(sent: bytes) -> socket.socket:
            opened.append(socket.create_connection(listener.getsockname(), 20))
            accepted, _ = listener.accept()
            opened.append(accepted)
            opened[-2].sendall(sent)
            if sent:
                accepted.settimeout(20)
                accepted.recv(1, socket.MSG_PEEK)
            refuse(accepted)
            assert accepted.fileno() == -1
            return opened[-2]

        yield send
        for s in opened:
            s.close()


@pytest.mark.parametrize("method", ["GET", "POST", "HEAD"])
def test_a_request_is_answered_with_a_problem_and_when_to_try_again(refused: Refused, method: str) -> None:
    s = refused(f"{method} /api/v1/runs/latest?a=b HTTP/1.1\r\nHost: localhost\r\n\r\n".encode())
    reply = HTTPResponse(s, method=method)
    reply.begin()
    assert (reply.status, reply.headers["Retry-After"], reply.headers["Connection"]) == (503, "1", "close")
    assert reply.headers["Content-Type"] == "application/problem+json"
    body = reply.read()
    if method == "HEAD":
        assert body == b""
    else:
        problem = Problem.model_validate(json.loads(body))
        assert (problem.code, problem.instance, problem.status) == ("busy", "/api/v1/runs/latest", 503)
    assert s.recv(1) == b""


@pytest.mark.parametrize("sent", [b"", b"\x16\x03\x01\x02\x00\x01\r\n\r\n", b"GET", b"GET http://a/ HTTP/1.1\r\n\r\n"])
def test_what_is_no_request_gets_no_answer(refused: Refused, sent: bytes) -> None:
    assert refused(sent).recv(1) == b""


def test_a_caller_that_has_gone_is_no_error(refused: Refused) -> None:
    ours, theirs = socket.socketpair()
    theirs.sendall(b"GET / HTTP/1.1\r\n\r\n")
    theirs.close()
    refuse(ours)
    assert ours.fileno() == -1
