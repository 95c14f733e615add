"""A transport that sends the head of a reply together with the beginning of its body."""

from __future__ import annotations

import asyncio
from typing import Any

_HEAD = b"HTTP/1."


class JoinedWrites:
    """A transport that holds the head of a reply back until the next write, at most for the present step of the loop.

    uvicorn writes head and body one after the other. Each write is a call of the kernel, which wakes the caller and
    lets another thread of this process have the interpreter.
    """

    def __init__(self, transport: asyncio.Transport, loop: asyncio.AbstractEventLoop) -> None:
        self._transport, self._loop = transport, loop
        self._head = b""

    def __getattr__(self, name: str) -> Any:
        # All that is not named here passes the transport unchanged.
        return getattr(self._transport, name)

    def write(self, data: bytes) -> None:
        """Send bytes, with the head that was held back."""
        if self._head:
            head, self._head = self._head, b""
            self._transport.write(head + data)
        elif data.startswith(_HEAD):
            self._head = data
            # A reply may have no body yet, as a stream of events.
            self._loop.call_soon(self._send_head)
        elif data:
            self._transport.write(data)

    def close(self) -> None:
        """Close the connection when everything is sent."""
        self._send_head()
        self._transport.close()

    def _send_head(self) -> None:
        if self._head:
            self.write(b"")
