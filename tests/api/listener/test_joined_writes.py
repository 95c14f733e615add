"""Head and body of a reply as one write."""

from __future__ import annotations

import asyncio
import socket
from typing import Any

import pytest

from vaoi_station.api.listener.joined_writes import JoinedWrites

HEAD = b"HTTP/1.1 200 OK\r\ncontent-length: 4\r\n\r\n"


class Writes(asyncio.Transport):
    """A transport that notes what it is to do."""

    def __init__(self) -> None:
        super().__init__({"peername": ("127.0.0.1", 1)})
        self.done: list[bytes | str] = []

    def write(self, data: Any) -> None:
        self.done.append(bytes(data))

    def close(self) -> None:
        self.done.append("closed")


def written(*steps: list[bytes | None]) -> list[bytes | str]:
    """Return what reaches the transport of the writes (None: close) in these steps of the loop."""

    async def write() -> list[bytes | str]:
        below = Writes()
        joined = JoinedWrites(below, asyncio.get_running_loop())
        assert joined.get_extra_info("peername") == ("127.0.0.1", 1)
        for step in steps:
            for data in step:
                if data is None:
                    joined.close()
                else:
                    joined.write(data)
            await asyncio.sleep(0)
        return below.done

    return asyncio.run(write())


@pytest.mark.parametrize(
    ("steps", "expected"),
    [
        ([[HEAD, b"body", b""]], [HEAD + b"body"]),
        ([[HEAD, b"bo", b"dy"]], [HEAD + b"bo", b"dy"]),
        ([[HEAD], [b"body"]], [HEAD, b"body"]),  # a stream begins before its first event
        ([[HEAD, b""], []], [HEAD]),
        ([[HEAD, b"body"], [HEAD, b"next"]], [HEAD + b"body", HEAD + b"next"]),
        ([[HEAD, None]], [HEAD, "closed"]),
        ([[HEAD, b"body", None]], [HEAD + b"body", "closed"]),
    ],
)
def test_a_head_is_sent_with_what_follows_in_the_same_step(
    steps: list[list[bytes | None]], expected: list[bytes | str]
) -> None:
    assert written(*steps) == expected


def test_replies_come_whole_over_a_connection_that_is_kept(served: Any) -> None:
    with socket.create_connection(("127.0.0.1", served.port), 20) as caller:
        for _ in range(3):
            caller.sendall(b"GET /web/icon.svg HTTP/1.1\r\nHost: localhost\r\n\r\n")
            assert b"</svg>" in caller.recv(1 << 20), "the first bytes that come are the whole reply"
