"""uvicorn's server behind an acceptor with limits."""

from __future__ import annotations

import socket
from collections.abc import Callable
from functools import partial
from typing import TYPE_CHECKING, Any

import uvicorn

from vaoi_station.api.certificate import CertificateFiles
from vaoi_station.api.listener.acceptor import Acceptor
from vaoi_station.api.listener.connections import ConnectionLimits, ConnectionTable
from vaoi_station.api.listener.http_connection import AcceptedConnection, LimitedHttp

if TYPE_CHECKING:
    from fastapi import FastAPI


class LimitedServer(uvicorn.Server):
    """The server of an application. All its connections come from acceptors, which limit them."""

    def __init__(
        self,
        app: FastAPI,
        limits: ConnectionLimits,
        grace_s: float,
        beat: Callable[[], object] = lambda: None,
        tls: CertificateFiles | None = None,
    ) -> None:
        """Prepare a server. Its event loop calls `beat` ten times a second, unless a handler blocks the loop."""
        super().__init__(
            uvicorn.Config(
                app,
                http="h11",
                ws="none",
                log_config=None,
                access_log=False,
                # A caller's limits are counted by its address, so no header may replace the address.
                proxy_headers=False,
                server_header=False,
                timeout_graceful_shutdown=int(grace_s),
            )
        )
        self._limits, self._beat, self._tls = limits, beat, tls

    async def on_tick(self, counter: int) -> bool:
        """Record that the event loop is alive; uvicorn calls this method ten times a second."""
        self._beat()
        return await super().on_tick(counter)

    async def startup(self, sockets: list[socket.socket] | None = None) -> None:
        """Start the application, then accept connections."""
        await super().startup(sockets=[])
        for listener in sockets or ():
            acceptor: Any = Acceptor(listener, self._make_http, self._limits, self._tls)
            self.servers.append(acceptor)

    def _make_http(self, accepted: AcceptedConnection, table: ConnectionTable) -> LimitedHttp:
        make = partial(LimitedHttp, self.config, self.server_state, self.lifespan.state)
        return make(accepted, table, self._limits)
