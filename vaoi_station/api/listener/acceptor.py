"""Accepts connections within limits, and closes those that have exceeded a time limit."""

from __future__ import annotations

import asyncio
import logging
import socket
from collections.abc import Callable
from functools import partial

from vaoi_station.api.certificate import RENEW_S, CertificateFiles
from vaoi_station.api.limits import caller_address
from vaoi_station.api.listener.connections import ConnectionLimits, ConnectionTable
from vaoi_station.api.listener.http_connection import AcceptedConnection, LimitedHttp
from vaoi_station.api.listener.refusal import refuse
from vaoi_station.api.listener.waiting_room import Turns, WaitingRoom

_log = logging.getLogger(__name__)

BACKLOG = 128
"""Largest number of connections that the kernel keeps until they are accepted."""
SWEEP_S = 0.5
_BATCH = 32
"""Number of connections that are accepted at a time before other work continues, so that a burst leaves descriptors."""
_PAUSE_S = 0.2
"""Pause after an accept that failed because of too few descriptors or too little memory, s."""
_LOG_EVERY_S = 60.0
_TRY_WAITING_S = 0.05
"""Time after which connections that wait are tried again, s."""

MakeHttp = Callable[[AcceptedConnection, ConnectionTable], LimitedHttp]


class Acceptor:
    """Accepts the connections of a listening socket. It has the methods that uvicorn expects of an asyncio server."""

    def __init__(
        self, listener: socket.socket, make_http: MakeHttp, limits: ConnectionLimits, tls: CertificateFiles | None
    ) -> None:
        self._listener, self._make_http, self._limits, self._tls = listener, make_http, limits, tls
        self._loop = asyncio.get_running_loop()
        self._log_after = 0.0
        self._refresh_after = self._loop.time() + RENEW_S
        self._refresh: asyncio.Future[None] | None = None
        self.table = ConnectionTable(limits)
        self._turns = Turns(limits.exchanges, limits.exchanges_per_s)
        self._waiting = WaitingRoom(limits)
        listener.setblocking(False)
        listener.listen(BACKLOG)
        self._accepting = True
        self._loop.add_reader(listener.fileno(), self._accept)
        self._loop.call_later(SWEEP_S, self._sweep)

    def close(self) -> None:
        """Accept no more connections."""
        self._accepting = False
        self._loop.remove_reader(self._listener.fileno())
        self._waiting.close()

    async def wait_closed(self) -> None:
        """Return at once: uvicorn waits for the connections itself."""

    def _accept(self) -> None:
        for _ in range(_BATCH):
            try:
                connected, peer = self._listener.accept()
            except (BlockingIOError, InterruptedError, ConnectionAbortedError):
                return
            except OSError as error:
                self._pause(error)
                return
            address, now = caller_address(peer[0]), self._loop.time()
            by_turn = not self.table.has_place(address)
            # Who comes later than a waiting connection of the same caller waits behind it.
            if address in self._waiting or not self._admit(address, connected, now, by_turn):
                self._let_wait(address, connected, now)

    def _admit(self, address: str, connected: socket.socket, now: float, by_turn: bool) -> bool:
        """Serve a connection, if necessary in place of another one. Return False if it must wait."""
        if by_turn and not self._turns.left(address, now):
            return False
        accepted = AcceptedConnection(address, now)
        if not self.table.admit(accepted, now):
            return False
        if by_turn:
            self._turns.take(address, now)
        accepted.task = self._loop.create_task(self._serve(accepted, connected))
        accepted.task.add_done_callback(partial(self._served, accepted, connected))
        return True

    def _let_wait(self, address: str, connected: socket.socket, now: float) -> None:
        """Let a connection wait for a place; refuse it if too many wait."""
        self._warn("%s has as many connections as it may, or opens new ones too fast: they wait", address)
        begins = not len(self._waiting)
        if not self._waiting.add(address, connected, now) and not self._waiting.refuse_later(connected):
            connected.close()
        elif begins:
            self._loop.call_later(_TRY_WAITING_S, self._try_waiting)

    def _try_waiting(self) -> None:
        """Serve the connections that wait, and come again while there are any."""
        try:
            now = self._loop.time()
            for connected in self._waiting.take_refused():
                self._refuse(connected)
            self._waiting.leave_closed()
            for address in self._waiting.addresses():
                self._serve_waiting(address, now)
        finally:
            if len(self._waiting):
                self._loop.call_later(_TRY_WAITING_S, self._try_waiting)

    def _serve_waiting(self, address: str, now: float) -> None:
        """Serve connections of a caller that have waited, as fast as it may; refuse those that have waited too long."""
        while (waiting := self._waiting.first(address)) is not None:
            # A free place takes a turn too, so that a caller that closes its own connections is no faster.
            if self._admit(address, waiting.connected, now, by_turn=True):
                self._waiting.leave(address)
            elif waiting.until <= now:
                self._waiting.leave(address)
                self._refuse(waiting.connected)
            else:
                return

    def _refuse(self, connected: socket.socket) -> None:
        """Answer the request on a connection with 503 and close it; over TLS only close it."""
        if self._tls is None:
            refuse(connected)
        else:
            connected.close()

    async def _serve(self, accepted: AcceptedConnection, connected: socket.socket) -> None:
        """Perform the handshake of one connection, then give the connection to its protocol."""
        try:
            connected.setblocking(False)
            await self._loop.connect_accepted_socket(
                lambda: self._make_http(accepted, self.table),
                connected,
                ssl=self._tls.context if self._tls else None,
                ssl_handshake_timeout=self._limits.handshake_s if self._tls else None,
                ssl_shutdown_timeout=self._limits.closing_s if self._tls else None,
            )
        except OSError as error:
            _log.debug("no connection with %s: %s", accepted.address, error)

    def _served(self, accepted: AcceptedConnection, connected: socket.socket, _: asyncio.Task[None]) -> None:
        """Close the socket of a connection whose handshake has failed or was cancelled, perhaps before it began."""
        accepted.task = None
        if accepted.http is None:
            self.table.discard(accepted)
            connected.close()

    def _pause(self, error: OSError) -> None:
        """Accept no connection for a moment after a failure that would repeat at once, and make room by closing one."""
        self._warn("connections cannot be accepted: %s", error)
        self.table.make_room()
        self._loop.remove_reader(self._listener.fileno())
        self._loop.call_later(_PAUSE_S, self._resume)

    def _resume(self) -> None:
        if self._accepting:
            self._loop.add_reader(self._listener.fileno(), self._accept)

    def _sweep(self) -> None:
        # First, so that an error with one connection ends neither this sweep for good nor the limits of the others.
        self._loop.call_later(SWEEP_S, self._sweep)
        self._turns.forget(self._loop.time())
        for connection in self.table:
            assert isinstance(connection, AcceptedConnection)
            if connection.http is not None and connection.http.overdue():
                connection.cut()
        if self._tls is not None and self._accepting:
            self._refresh_certificate(self._tls)

    def _refresh_certificate(self, files: CertificateFiles) -> None:
        """Begin to read a changed certificate, unless the last reading has not ended because the disk hangs."""
        if self._loop.time() >= self._refresh_after and (self._refresh is None or self._refresh.done()):
            self._refresh_after = self._loop.time() + RENEW_S
            self._refresh = self._loop.run_in_executor(None, files.refresh)

    def _warn(self, message: str, *values: object) -> None:
        if self._loop.time() >= self._log_after:
            self._log_after = self._loop.time() + _LOG_EVERY_S
            _log.warning(message, *values)
