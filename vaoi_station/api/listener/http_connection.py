"""One HTTP connection of uvicorn, with limits of the time for sending a request and for reading the reply."""

from __future__ import annotations

import asyncio
import logging
import time
from typing import Any, cast

from h11 import LocalProtocolError
from uvicorn import Config
from uvicorn.protocols.http.h11_impl import H11Protocol
from uvicorn.server import ServerState

from vaoi_station.api.listener.connections import ConnectionLimits, ConnectionTable, Idleness
from vaoi_station.api.listener.joined_writes import JoinedWrites

STREAM = "/api/v1/events"
"""Path, perhaps behind the prefix of a proxy, whose reply has no end: only the time without progress is limited."""
_SLOW_READER_S = 2.0
"""A caller that has not read for this time, s, may lose its connection to a new one."""
_LINGER_S = 1.0
"""Time for which a TLS connection stays after its last reply, s, so that the caller receives all of it."""
_QUIET_S = 10.0


class _SeldomFilter(logging.Filter):
    """Log filter that passes a warning at most every `_QUIET_S`; a caller can send thousands of invalid requests."""

    def __init__(self) -> None:
        super().__init__()
        self._next = 0.0

    def filter(self, record: logging.LogRecord) -> bool:
        if record.levelno != logging.WARNING:
            return True
        now = time.monotonic()
        if now < self._next:
            return False
        self._next = now + _QUIET_S
        return True


_log = logging.getLogger("vaoi_station.api.requests")
_log.addFilter(_SeldomFilter())


class AcceptedConnection:
    """An accepted socket, from the TLS handshake to its end, as an entry of the table of connections."""

    def __init__(self, address: str, since: float) -> None:
        self.address, self._since = address, since
        self.http: LimitedHttp | None = None
        self.task: asyncio.Task[None] | None = None
        """The task that performs the handshake."""

    def idleness(self) -> Idleness | None:
        """Return how little the connection is needed; None while a request is under way."""
        return Idleness(False, self._since) if self.http is None else self.http.idleness()

    def cut(self) -> None:
        """Close the connection at once."""
        if self.http is not None:
            self.http.transport.abort()
        elif self.task is not None:
            self.task.cancel()


class LimitedHttp(H11Protocol):
    """The protocol of one connection. The acceptor regularly calls its method `overdue`."""

    def __init__(
        self,
        config: Config,
        state: ServerState,
        lifespan_state: dict[str, Any],
        accepted: AcceptedConnection,
        table: ConnectionTable,
        limits: ConnectionLimits,
    ) -> None:
        super().__init__(config, state, lifespan_state)
        self.logger = _log
        self._accepted, self._table, self._limits = accepted, table, limits
        self._since = self.loop.time()
        """Time at which the connection was made, the present request began, or the last reply was complete."""
        self._paused: float | None = None
        """Time since which the caller's connection accepts no more bytes; None while it accepts bytes."""
        self._waited_s = 0.0
        """Total time for which the present reply has waited for its reader before."""
        self._closing: float | None = None
        self._served = False

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        """Begin to count the time until the first request."""
        super().connection_made(cast("asyncio.Transport", JoinedWrites(transport, self.loop)))
        self._accepted.http = self
        self._since = self.loop.time()

    def connection_lost(self, exc: Exception | None) -> None:
        """Remove the connection from the table, which frees its place."""
        self._table.discard(self._accepted)
        super().connection_lost(exc)

    def shutdown(self) -> None:
        """End the connection because the server stops: at once if it is idle, else after the reply under way."""
        super().shutdown()
        if self.overdue():
            self.transport.abort()

    def data_received(self, data: bytes) -> None:
        """Process received bytes, and record when they complete the head of a request."""
        before = self.cycle
        super().data_received(data)
        self._note_request(before)

    def on_response_complete(self) -> None:
        """Count the time until the next request from now on."""
        self._served = True
        self._since = self.loop.time()
        before = self.cycle
        super().on_response_complete()
        self._note_request(before)

    def send_400_response(self, msg: str) -> None:
        """Refuse bytes that are not an HTTP request."""
        try:
            super().send_400_response(msg)
        except LocalProtocolError:
            # The bytes followed a request whose reply is under way: no other reply can be sent any more.
            self.transport.abort()

    def pause_writing(self) -> None:
        """Record that the caller does not read as fast as the reply is sent."""
        self._paused = self.loop.time()
        super().pause_writing()

    def resume_writing(self) -> None:
        """Record that the caller has read."""
        if self._paused is not None:
            self._waited_s += self.loop.time() - self._paused
            self._paused = None
        super().resume_writing()

    def idleness(self) -> Idleness | None:
        """Return how little the connection is needed; None while a request is under way."""
        if self._closing is not None:
            return Idleness(False, self._closing)
        if self._paused is not None:
            return Idleness(False, self._paused) if self.loop.time() - self._paused > _SLOW_READER_S else None
        if self._answered():
            return Idleness(self._served, self._since)
        return Idleness(False, self._since) if self.cycle.more_body else None

    def overdue(self) -> bool:
        """Return whether the connection has exceeded one of its time limits. Called regularly."""
        now = self.loop.time()
        if self.transport.is_closing():
            self._closing = now if self._closing is None else self._closing
            if now - self._since > _LINGER_S and self._awaits_end_of_tls():
                return True
            return now - self._closing > self._limits.closing_s
        if self._paused is not None:
            paused_s = now - self._paused
            stream = self.scope is not None and self.scope["path"].endswith(STREAM)
            too_long = self._waited_s + paused_s > self._limits.answer_s and not stream
            return paused_s > self._limits.stall_s or too_long
        return self._answered() and now - self._since > self._limits.head_s

    def _awaits_end_of_tls(self) -> bool:
        """Return whether a closed TLS connection has sent everything, and waits only for the caller's end of TLS.

        A program that keeps an idle connection for its next request does not read, so that it never sends that.
        """
        # asyncio has no public access to the transport below TLS. If its names change, the time limit applies.
        below = getattr(getattr(self.transport, "_ssl_protocol", None), "_transport", None)
        return below is not None and not below.get_write_buffer_size() and not self.transport.get_write_buffer_size()

    def _answered(self) -> bool:
        return self.cycle is None or self.cycle.response_complete

    def _note_request(self, before: object) -> None:
        if self.cycle is not before:
            self._since, self._waited_s = self.loop.time(), 0.0
