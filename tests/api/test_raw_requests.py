"""Requests that no HTTP library sends, over a raw socket: where they end and whom they address is never ambiguous."""

from __future__ import annotations

import socket
from collections.abc import Iterator
from typing import Any

import pytest

from tests.api.conftest import Served
from tests.api.held_station import HeldStation

POST = b"POST /api/v1/station/disarm HTTP/1.1\r\n"
GET = b"GET /api/v1/station HTTP/1.1\r\n"
HOST = b"Host: localhost\r\n"
CHUNKED = b"Transfer-Encoding: chunked\r\n"
EMPTY = b"Content-Length: 0\r\n"
HIDDEN = b"GET /api/v1/hidden HTTP/1.1\r\nHost: localhost\r\n\r\n"
"""A second request, which must not be answered if it stands behind one that is refused."""


@pytest.fixture(scope="module")
def served() -> Iterator[Served]:
    """One service for all requests: none of them may disturb the next."""
    service = Served(HeldStation())
    yield service
    service.stop()


def exchange(served: Any, sent: bytes) -> bytes:
    """Send bytes and a last request that closes the connection; return all answers."""
    last = b"GET /healthz HTTP/1.1\r\nHost: localhost\r\nConnection: close\r\n\r\n"
    with socket.create_connection(("127.0.0.1", served.port), 20) as s:
        s.sendall(sent + last)
        answer = bytearray()
        try:
            while got := s.recv(65536):
                answer += got
        except ConnectionResetError:
            pass  # the station has closed without reading the rest
    return bytes(answer)


REFUSED = {
    "two hosts": POST + HOST + b"Host: evil.example\r\n" + EMPTY + b"\r\n",
    "one host twice": POST + HOST + HOST + EMPTY + b"\r\n",
    "no host": POST + EMPTY + b"\r\n",
    "two lengths": POST + HOST + EMPTY + b"Content-Length: 5\r\n\r\n",
    "list of lengths": POST + HOST + b"Content-Length: 0, 5\r\n\r\n",
    "length, then chunks": POST + HOST + b"Content-Length: 4\r\n" + CHUNKED + b"\r\n0\r\n\r\n",
    "chunks, then length": POST + HOST + CHUNKED + b"Content-Length: 4\r\n\r\n0\r\n\r\n",
    "chunks of chunks": POST + HOST + CHUNKED + b"Transfer-Encoding: identity\r\n\r\n0\r\n\r\n",
    "packed chunks": POST + HOST + b"Transfer-Encoding: gzip, chunked\r\n\r\n0\r\n\r\n",
    "unknown encoding": POST + HOST + b"Transfer-Encoding: xchunked\r\n\r\n0\r\n\r\n",
    "space before the colon": POST + HOST + b"Transfer-Encoding : chunked\r\n" + EMPTY + b"\r\n0\r\n\r\n",
    "length with a sign": POST + HOST + b"Content-Length: +0\r\n\r\n",
    "negative length": POST + HOST + b"Content-Length: -1\r\n\r\n",
    "hexadecimal length": POST + HOST + b"Content-Length: 0x0\r\n\r\n",
    "length with an underscore": POST + HOST + b"Content-Length: 1_0\r\n\r\n0123456789",
    "length of 400 digits": POST + HOST + b"Content-Length: " + b"9" * 400 + b"\r\n\r\n",
    "chunk of 0x0": POST + HOST + CHUNKED + b"\r\n0x0\r\n\r\n",
    "chunk of -1": POST + HOST + CHUNKED + b"\r\n-1\r\n\r\n",
    "chunk of 2^120": POST + HOST + CHUNKED + b"\r\n" + b"f" * 30 + b"\r\n\r\n",
    "chunk without its end": POST + HOST + CHUNKED + b"\r\n2\r\n{}XX0\r\n\r\n",
    "zero byte": POST + HOST + b"X-A: a\x00b\r\n" + EMPTY + b"\r\n",
    "HTTP/0.9": b"GET /api/v1/station\r\n\r\n",
    "two origins": POST + HOST + b"Origin: http://localhost\r\nOrigin: http://evil.example\r\n" + EMPTY + b"\r\n",
    "two keys": GET + HOST + b"Authorization: Bearer a\r\nAuthorization: Bearer b\r\n\r\n",
    "two sites": GET + HOST + b"Sec-Fetch-Site: same-origin\r\nSec-Fetch-Site: cross-site\r\n\r\n",
}


@pytest.mark.parametrize("name", REFUSED)
def test_an_ambiguous_request_is_refused_and_nothing_behind_it_is_answered(served: Any, name: str) -> None:
    answer = exchange(served, REFUSED[name] + HIDDEN)
    assert answer.startswith(b"HTTP/1.1 400 ")
    assert answer.count(b"HTTP/1.1 ") == 1
    assert b"hidden" not in answer


ACCEPTED = {
    "a folded header": POST + HOST + EMPTY + b"X-A: b\r\n Transfer-Encoding: chunked\r\n\r\n",
    "a tab before the value": POST + HOST + b"Transfer-Encoding:\tchunked\r\n\r\n0\r\n\r\n",
    "trailers, which count for nothing": POST + HOST + CHUNKED + b"\r\n0\r\nHost: x\r\nContent-Length: 9\r\n\r\n",
    "HTTP/1.0 with a host": POST.replace(b"1.1", b"1.0") + HOST + EMPTY + b"Connection: keep-alive\r\n\r\n",
}


@pytest.mark.parametrize("name", ACCEPTED)
def test_an_unusual_request_is_answered_once(served: Any, name: str) -> None:
    answer = exchange(served, ACCEPTED[name])
    assert answer.startswith(b"HTTP/1.1 200 ")
    assert answer.count(b"HTTP/1.1 ") <= 2


@pytest.mark.parametrize(
    ("line", "status"),
    [
        (b"GET http://evil.example/api/v1/station HTTP/1.1", b"404"),
        (b"CONNECT evil.example:443 HTTP/1.1", b"404"),
        (b"TRACE /api/v1/station HTTP/1.1", b"405"),
        (b"OPTIONS * HTTP/1.1", b"404"),
        (b"PRI * HTTP/2.0", b"404"),
        (b"GET //api/v1/station HTTP/1.1", b"404"),
        (b"GET /web/../../middleware.py HTTP/1.1", b"404"),
        (b"GET /web/%2e%2e/%2e%2e/middleware.py HTTP/1.1", b"404"),
    ],
)
def test_addresses_of_proxies_and_paths_out_of_the_pages_lead_nowhere(served: Any, line: bytes, status: bytes) -> None:
    assert exchange(served, line + b"\r\n" + HOST + b"\r\n").startswith(b"HTTP/1.1 " + status)


FOREIGN = {
    "<img>": b"Sec-Fetch-Site: cross-site\r\nSec-Fetch-Mode: no-cors\r\nSec-Fetch-Dest: image\r\n",
    "<script>": b"Sec-Fetch-Site: cross-site\r\nSec-Fetch-Mode: no-cors\r\nSec-Fetch-Dest: script\r\n",
    "<iframe>": b"Sec-Fetch-Site: cross-site\r\nSec-Fetch-Mode: navigate\r\nSec-Fetch-Dest: iframe\r\n",
    "<iframe>, clicked": b"Sec-Fetch-Site: cross-site\r\nSec-Fetch-Mode: navigate\r\nSec-Fetch-Dest: iframe\r\n"
    b"Sec-Fetch-User: ?1\r\n",
    "fetch()": b"Origin: http://evil.example\r\nSec-Fetch-Site: cross-site\r\nSec-Fetch-Mode: cors\r\n",
    "fetch() of an old browser": b"Origin: http://evil.example\r\n",
    "another port of this machine": b"Origin: http://localhost:1\r\nSec-Fetch-Site: same-site\r\n",
    "a file": b"Origin: null\r\n",
    "a link without a click": b"Sec-Fetch-Site: cross-site\r\nSec-Fetch-Mode: navigate\r\nSec-Fetch-Dest: document\r\n",
}


@pytest.mark.parametrize("name", FOREIGN)
def test_nothing_of_the_api_is_shown_on_a_foreign_page(served: Any, name: str) -> None:
    answer = exchange(served, b"GET /%61pi/v1/runs/x HTTP/1.1\r\n" + HOST + FOREIGN[name] + b"\r\n")
    assert answer.startswith(b"HTTP/1.1 403 ")
    assert b"foreign-origin" in answer
