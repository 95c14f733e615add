"""A web server in a separate thread, on a socket that the caller has opened."""

from __future__ import annotations

import errno
import logging
import os
import socket
import sys
import threading
from collections.abc import Callable

from fastapi import FastAPI

from vaoi_station.api.certificate import CertificateFiles
from vaoi_station.api.listener.connections import ConnectionLimits
from vaoi_station.errors import DeviceError, InternalError
from vaoi_station.supervised_thread import SupervisedThread

_log = logging.getLogger(__name__)

_IP_FREEBIND = 15
"""Number of a socket option of Linux for which Python has no name; it works for IPv6 too."""
HTTP_GRACE_S = 5.0
"""Time, s, in which requests under way may finish when the server stops."""
SEND_BYTES = 256 * 1024
"""Memory of the kernel for the unread reply of a connection, bytes; the kernel uses twice as much."""
_REQUEST_THREAD, _LEFT_S = "AnyIO worker thread", 0.5
"""Name of the threads in which AnyIO runs requests, and the time for each of them to end after the server."""
SWITCH_S = 0.0005
"""Time, s, after which a thread that computes in Python lets another one have the interpreter; by default 5 ms.

A reply waits so long each time that it returns from the kernel while another thread computes."""
LOOP_LIMIT_S = 60.0
"""Longest time, s, for which a request may block the event loop. After it, the server counts as hung."""


class WebServer:
    """The web server uvicorn in a separate thread. The main thread keeps its signal handlers."""

    def __init__(
        self,
        app: FastAPI,
        listener: socket.socket,
        ended: Callable[[], None],
        limits: ConnectionLimits | None = None,
        tls: CertificateFiles | None = None,
    ) -> None:
        """Prepare the server. When it ends, for any cause, it calls `ended`. With `tls` it accepts only TLS."""
        # Imported here: uvicorn takes long to load, and most commands do not serve.
        from vaoi_station.api.listener.server import LimitedServer

        self._listener, self._ended, self._grace_s = listener, ended, 2 * HTTP_GRACE_S
        self._stop_requested = self._failed = False
        self.thread = SupervisedThread(self._run, "api", LOOP_LIMIT_S)
        limits = limits or ConnectionLimits.of_this_process()
        self._server = LimitedServer(app, limits, HTTP_GRACE_S, self._beat, tls)
        self._scheme = "http" if tls is None else "https"

    @property
    def address(self) -> str:
        """URL of the server without a path."""
        host, port = self._listener.getsockname()[:2]
        return f"{self._scheme}://[{host}]:{port}" if ":" in host else f"{self._scheme}://{host}:{port}"

    def start(self) -> None:
        """Start to serve requests, in a thread. From now on the threads of this process take short turns."""
        sys.setswitchinterval(SWITCH_S)
        self.thread.start()
        _log.info("listening on %s", self.address)

    def stop(self) -> None:
        """Finish the requests under way, then end."""
        self._stop_requested = True
        self.thread.expect_end()
        self._server.should_exit = True
        self.thread.join(self._grace_s)

    def end_process_if_left(self) -> None:
        """End this process with code 0 if requests did not end in time after `stop`; else return.

        The last call of a process: at its end Python would end their threads within compiled code of a library, which
        aborts the process (SIGABRT), so that systemd counts an orderly stop as a failure.
        """
        # The server may have ended, and have left the thread of a request that cannot be cancelled.
        serving = [self.thread, *(t for t in threading.enumerate() if t.name == _REQUEST_THREAD)]
        for thread in serving:
            thread.join(_LEFT_S)
        if self._stop_requested and any(thread.is_alive() for thread in serving):
            _log.warning(
                "requests did not end within %g s after the stop; the process ends without them", self._grace_s
            )
            logging.shutdown()
            os._exit(0)

    def check(self) -> None:
        """Raise InternalError if the server ended without a call of `stop`."""
        if self._failed:
            raise InternalError("The web server ended unexpectedly; the log has the cause.")

    def _beat(self) -> None:
        self.thread.beat()

    def _run(self) -> None:
        try:
            self._server.run(sockets=[self._listener])
        finally:
            # The failure is recorded here, because `stop` may be called before this thread has ended.
            self._failed = not self._stop_requested
            # The end is reported here, so that the supervisor need not report it again.
            self.thread.expect_end()
            # A station without a web server cannot be used: this call lets the owner stop the station.
            self._ended()


def open_listener(host: str, port: int, where: str) -> socket.socket:
    """Open a listening socket, also at an address that no interface has yet.

    Raises:
        DeviceError: the port is in use or not permitted, or the host name is not known yet (code `address-absent`). The
            message names `where`, the place that defines the address.
    """
    # The listener is opened before everything else starts, so that a port in use is reported at once.
    family = socket.AF_INET6 if ":" in host else socket.AF_INET
    listener = socket.socket(family, socket.SOCK_STREAM)
    try:
        # A reply may take several writes. Without this option, Nagle's algorithm holds back the second one
        # until the caller's kernel acknowledges the first. On a connection that is used again, this takes 40 ms.
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_NODELAY, 1)
        # Without a limit, the kernel takes several MB for each caller that does not read.
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BYTES)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:
            listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        # At boot, the network may be ready later than the station. With this option, the kernel accepts the address at
        # once, and connections arrive as soon as an interface has it (ip(7)).
        listener.setsockopt(socket.IPPROTO_IP, _IP_FREEBIND, 1)
        listener.bind((host, port))
        listener.listen()
    except OSError as error:
        listener.close()
        passes = isinstance(error, socket.gaierror) or error.errno == errno.EADDRNOTAVAIL
        raise DeviceError(
            f"{where}: cannot listen on {host} port {port} ({error.strerror}).",
            action="Check the name and the network." if passes else "Stop the other station, or set another port.",
            code="address-absent" if passes else None,
        ) from error
    return listener
