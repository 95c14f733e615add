"""A service with short limits, and raw connections to it."""

from __future__ import annotations

import socket
from collections.abc import Callable, Iterator
from contextlib import ExitStack
from typing import Any

import pytest

from vaoi_station.api.listener.connections import ConnectionLimits

SHORT = ConnectionLimits(total=12, per_address=10, head_s=1.0, stall_s=1.0, answer_s=4.0, closing_s=1.0)


@pytest.fixture
def limited(station: Any, serve: Any) -> Iterator[Any]:
    server = serve(station, limits=SHORT)
    yield server
    server.stop()


@pytest.fixture
def connect(limited: Any) -> Iterator[Callable[..., socket.socket]]:
    """Return a function that opens a connection to the service and sends some bytes."""
    with ExitStack() as opened:

        def made(sent: bytes = b"", receive_bytes: int | None = None) -> socket.socket:
            s = opened.enter_context(socket.socket())
            if receive_bytes is not None:
                s.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, receive_bytes)
            s.settimeout(20)
            s.connect(("127.0.0.1", limited.port))
            s.sendall(sent)
            return s

        yield made
