"""Checks of every request, and security headers of every reply."""

from __future__ import annotations

import asyncio
import json
import socket
from collections.abc import Iterator
from contextlib import ExitStack
from typing import Any

import pytest
from starlette.types import Message

from vaoi_station.api.middleware import MAX_BODY_BYTES, Bodies

ARM = "/api/v1/station/arm"
ORDER = '{"board_type": "demo-board", "board_id": "B1"}'


@pytest.mark.parametrize("path", ["/", "/docs", "/healthz", "/api/v1/station", "/nowhere", "/web/app.js"])
def test_pages_may_load_nothing_from_other_sites(untouched_client: Any, path: str) -> None:
    headers = untouched_client.get(path).headers
    assert "default-src 'self'" in headers["content-security-policy"]
    assert headers["x-content-type-options"] == "nosniff"


@pytest.mark.parametrize("origin", ["http://evil.example", "null", "http://testserver:81", "https://testserver.evil"])
def test_commands_from_other_origins_are_refused(client: Any, station: Any, origin: str) -> None:
    answer = client.post(ARM, content=ORDER, headers={"origin": origin})
    assert (answer.status_code, answer.json()["code"]) == (403, "foreign-origin")
    assert station.armed is None


def test_bodies_are_limited_with_and_without_content_length(untouched_client: Any) -> None:
    def drops() -> Iterator[bytes]:
        for _ in range(MAX_BODY_BYTES // 65536 + 1):
            yield b" " * 65536

    for body in (b" " * (MAX_BODY_BYTES + 1), drops()):
        answer = untouched_client.put("/api/v1/board-types/x", content=body)
        assert (answer.status_code, answer.json()["code"]) == (413, "too-large")
        assert str(MAX_BODY_BYTES) in answer.json()["detail"]


@pytest.mark.parametrize(
    "host", ["rebound.example", "rebound.example:8350", "localhost.evil.example", "127.0.0.1.evil", "::x"]
)
def test_unknown_host_names_are_refused(client: Any, station: Any, host: str) -> None:
    for answer in (client.get("/", headers={"host": host}), client.post(ARM, content=ORDER, headers={"host": host})):
        assert (answer.status_code, answer.json()["code"]) == (421, "unknown-host")
        assert (
            answer.json()["action"] == "Use the station's IP address, or add the name to [api] names in station.toml."
        )
    assert station.armed is None


def test_a_slow_body_is_refused() -> None:
    async def never(scope: Any, receive: Any, send: Any) -> None:
        raise AssertionError("a request without its body has come through")

    async def ask() -> list[Message]:
        sent: list[Message] = []
        first = [{"type": "http.request", "body": b"{", "more_body": True}]

        async def receive() -> Message:
            if first:
                return first.pop()
            await asyncio.Event().wait()
            raise AssertionError

        async def send(message: Message) -> None:
            sent.append(message)

        scope = {"type": "http", "method": "POST", "path": ARM, "headers": [(b"host", b"localhost")]}
        await Bodies(never, body_limit_s=0.01)(scope, receive, send)
        return sent

    start, body = asyncio.run(ask())
    assert start["status"] == 408
    assert (b"connection", b"close") in start["headers"]
    assert json.loads(body["body"])["code"] == "too-slow"


@pytest.mark.parametrize("path", ["/", "/healthz", "/api/v1/station", "/api/v1/board-types/demo-board", "/nowhere"])
def test_head_is_get_without_its_body(untouched_client: Any, path: str) -> None:
    full, head = untouched_client.get(path), untouched_client.head(path)
    assert head.content == b""
    assert head.status_code == full.status_code
    assert head.headers["content-type"] == full.headers["content-type"]
    assert head.headers.get("etag") == full.headers.get("etag")


@pytest.mark.parametrize("missing", ["sec-fetch-mode", "sec-fetch-dest", "sec-fetch-user"])
def test_a_link_that_a_person_follows_is_accepted(untouched_client: Any, missing: str) -> None:
    link = {
        "sec-fetch-site": "cross-site",
        "sec-fetch-mode": "navigate",
        "sec-fetch-dest": "document",
        "sec-fetch-user": "?1",
    }
    assert untouched_client.get("/api/v1/station", headers=link).status_code == 200
    del link[missing]
    assert untouched_client.get("/api/v1/station", headers=link).status_code == 403
    assert untouched_client.get("/", headers=link).status_code == 200


def test_large_bodies_of_one_caller_are_limited_and_its_commands_are_not(served: Any) -> None:
    """Otherwise every connection could hold 8 MB of a body that never ends."""
    head = b"PUT /api/v1/board-types/x HTTP/1.1\r\nHost: localhost\r\nContent-Length: 8000000\r\n\r\n{"
    with ExitStack() as opened:
        for _ in range(2):
            opened.enter_context(socket.create_connection(("127.0.0.1", served.port), 20)).sendall(head)
        while len(served._server._server.server_state.tasks) < 2:
            served.client.get("/healthz")
        answer = served.client.put("/api/v1/board-types/y", content=b" " * 1_000_000)
        assert (answer.status_code, answer.json()["code"]) == (503, "busy")
        assert "bytes of requests in memory" in answer.json()["detail"]
        assert served.client.post("/api/v1/station/arm?board_type=demo-board").status_code == 200
