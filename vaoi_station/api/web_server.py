"""A web server in a thread of its own, on a socket that was opened beforehand."""

from __future__ import annotations

import logging
import socket
import threading
from collections.abc import Callable

from fastapi import FastAPI

from vaoi_station.errors import DeviceError, InternalError

_log = logging.getLogger(__name__)

HTTP_GRACE_S = 5.0


class WebServer:
    """uvicorn in a thread, so that signals stay those of whoever started it."""

    def __init__(self, app: FastAPI, listener: socket.socket, ended: Callable[[], None]) -> None:
        """`ended` is called when it ends, for whatever reason."""
        import uvicorn

        self._listener, self._ended, self._asked = listener, ended, False
        self._server = uvicorn.Server(
            uvicorn.Config(app, log_config=None, access_log=False, timeout_graceful_shutdown=int(HTTP_GRACE_S))
        )
        self._thread = threading.Thread(target=self._run, name="api", daemon=True)

    @property
    def address(self) -> str:
        """Where it answers."""
        host, port = self._listener.getsockname()[:2]
        return f"http://[{host}]:{port}" if ":" in host else f"http://{host}:{port}"

    def start(self) -> None:
        """Begin to answer."""
        self._thread.start()
        _log.info("listening on %s", self.address)

    def stop(self) -> None:
        """Finish what is being answered, then end."""
        self._asked = self._thread.is_alive()
        self._server.should_exit = True
        self._thread.join(2 * HTTP_GRACE_S)

    def check(self) -> None:
        """Raise InternalError if it ended without being asked to."""
        if not self._asked:
            raise InternalError("The web server ended by itself; the log says why.")

    def _run(self) -> None:
        try:
            self._server.run(sockets=[self._listener])
        finally:
            self._ended()  # without its web server the station is of no use


def open_listener(host: str, port: int, where: str) -> socket.socket:
    """A listening socket; DeviceError, which names `where` the address was given, if it cannot be had."""
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    try:
        return socket.create_server((host, port), family=family)
    except OSError as error:
        raise DeviceError(
            f"{where}: cannot listen on {host} port {port} ({error.strerror}).",
            action="Stop the other station, or set another port.",
        ) from error
