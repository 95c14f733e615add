"""The web server: uvicorn in a separate thread, on a socket that the caller has opened.

Limits are those of the kernel and of uvicorn. A machine that many callers reach, or hostile ones, has nginx in front
(`deploy/nginx.conf`).
"""

from __future__ import annotations

import asyncio
import errno
import logging
import os
import resource
import socket
import sys
import threading
from collections.abc import Callable
from typing import TYPE_CHECKING, Any, cast

import uvicorn
from uvicorn.protocols.http.h11_impl import H11Protocol

from vaoi_station.api.certificate import RENEW_S, CertificateFiles
from vaoi_station.errors import DeviceError, InternalError
from vaoi_station.supervised_thread import SupervisedThread

if TYPE_CHECKING:
    from fastapi import FastAPI

_log = logging.getLogger(__name__)

_IP_FREEBIND = 15
"""Number of a socket option of Linux for which Python has no name; it works for IPv6 too."""
HTTP_GRACE_S = 5.0
"""Time, s, in which requests under way may finish when the server stops."""
SEND_BYTES = 256 * 1024
"""Memory of the kernel for the unread reply of a connection, bytes; the kernel uses twice as much."""
IDLE_S = 20
"""Longest time without a request under way, until the head of the next one has arrived, s."""
LINGER_S = 1.0
"""Time for which an idle connection stays after the server has ended it, s."""
STALL_S = 10.0
"""Longest time in which a caller reads nothing of its reply, s."""
BACKLOG = 128
"""Largest number of connections that the kernel keeps until they are accepted."""
MOST_FILES = 8192
"""Number of files that the process may open, if the machine permits it: each connection is one."""
MOST_CONNECTIONS = MOST_FILES // 2
"""Connections above which requests are answered with 503: recordings and the database need files, too."""
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
        tls: CertificateFiles | None = None,
        idle_s: int = IDLE_S,
    ) -> None:
        """Prepare the server. When it ends, for any cause, it calls `ended`. With `tls` it accepts only TLS."""
        self._listener, self._ended, self._grace_s = listener, ended, 2 * HTTP_GRACE_S
        self._stop_requested = self._failed = False
        self.thread = SupervisedThread(self._run, "api", LOOP_LIMIT_S)
        config = uvicorn.Config(
            app,
            http=_Connection,
            ws="none",
            log_config=None,
            access_log=False,
            proxy_headers=False,  # `addresses.as_addressed` reads them
            server_header=False,
            backlog=BACKLOG,
            limit_concurrency=MOST_CONNECTIONS,
            timeout_keep_alive=idle_s,
            timeout_graceful_shutdown=int(HTTP_GRACE_S),
            ssl_context_factory=None if tls is None else lambda *_: tls.context,
        )
        self._server = _Server(config, tls, self.thread)
        self._scheme = "http" if tls is None else "https"

    @property
    def address(self) -> str:
        """URL of the server without a path."""
        host, port = self._listener.getsockname()[:2]
        return f"{self._scheme}://[{host}]:{port}" if ":" in host else f"{self._scheme}://{host}:{port}"

    def start(self) -> None:
        """Start to serve requests, in a thread. From now on the threads of this process take short turns."""
        sys.setswitchinterval(SWITCH_S)
        # A caller can send thousands of invalid requests, each of which is a warning.
        logging.getLogger("uvicorn.error").setLevel(logging.ERROR)
        soft, hard = resource.getrlimit(resource.RLIMIT_NOFILE)
        wanted = MOST_FILES if hard == resource.RLIM_INFINITY else min(MOST_FILES, hard)
        if soft != resource.RLIM_INFINITY and soft < wanted:
            resource.setrlimit(resource.RLIMIT_NOFILE, (wanted, hard))
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


class _Server(uvicorn.Server):
    """uvicorn's server, whose event loop calls the thread's `beat` ten times a second unless a request blocks it."""

    def __init__(self, config: uvicorn.Config, tls: CertificateFiles | None, thread: SupervisedThread) -> None:
        super().__init__(config)
        self._tls, self._thread, self._refresh_at = tls, thread, 0.0

    async def on_tick(self, counter: int) -> bool:
        self._thread.beat()
        loop = asyncio.get_running_loop()
        if self._tls is not None and loop.time() >= self._refresh_at:
            self._refresh_at = loop.time() + RENEW_S
            loop.run_in_executor(None, self._tls.refresh)
        return await super().on_tick(counter)


class _Connection(H11Protocol):
    """A connection that ends unless a request arrives in time: uvicorn limits only the time after a reply."""

    def connection_made(self, transport: asyncio.Transport) -> None:  # type: ignore[override]
        super().connection_made(cast("asyncio.Transport", _JoinedWrites(transport, self.loop)))
        self._wait_for_request()

    def data_received(self, data: bytes) -> None:
        super().data_received(data)
        self._note_request()

    def on_response_complete(self) -> None:
        if self._idle is None:
            self._wait_for_request()
        super().on_response_complete()
        self._note_request()

    def connection_lost(self, exc: Exception | None) -> None:
        super().connection_lost(exc)
        self._end_wait()

    def shutdown(self) -> None:
        super().shutdown()
        if self._idle is not None:
            # A caller that keeps a TLS connection for its next request does not read, nor end TLS, until then.
            self.loop.call_later(LINGER_S, self.transport.abort)

    def _wait_for_request(self) -> None:
        self._idle: asyncio.TimerHandle | None = self.loop.call_later(
            self.config.timeout_keep_alive, self.transport.abort
        )

    def _note_request(self) -> None:
        if self.cycle is not None and not self.cycle.response_complete:
            self._end_wait()

    def _end_wait(self) -> None:
        if self._idle is not None:
            self._idle.cancel()
            self._idle = None


class _JoinedWrites:
    """A transport that sends the head of a reply together with the beginning of its body.

    uvicorn writes head and body one after the other. Each write is a call of the kernel, which wakes the caller and
    lets another thread of this process have the interpreter.
    """

    def __init__(self, transport: asyncio.Transport, loop: asyncio.AbstractEventLoop) -> None:
        self._transport, self._loop, self._head = transport, loop, b""

    def __getattr__(self, name: str) -> Any:
        # All that is not named here passes the transport unchanged.
        return getattr(self._transport, name)

    def write(self, data: bytes) -> None:
        """Send bytes, with the head that was held back, at most for the present step of the loop."""
        if self._head:
            head, self._head = self._head, b""
            self._transport.write(head + data)
        elif data.startswith(b"HTTP/1."):
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
        # Without a limit, the kernel takes several MB for each caller that does not read. One that reads nothing of
        # its reply, or has gone without a word, is disconnected; one that sends nothing is not accepted (tcp(7)).
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_SNDBUF, SEND_BYTES)
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_USER_TIMEOUT, int(1000 * STALL_S))
        listener.setsockopt(socket.IPPROTO_TCP, socket.TCP_DEFER_ACCEPT, IDLE_S)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_KEEPALIVE, 1)
        listener.setsockopt(socket.SOL_SOCKET, socket.SO_REUSEADDR, 1)
        if family == socket.AF_INET6:
            listener.setsockopt(socket.IPPROTO_IPV6, socket.IPV6_V6ONLY, 1)
        # At boot, the network may be ready later than the station. With this option, the kernel accepts the address at
        # once, and connections arrive as soon as an interface has it (ip(7)).
        listener.setsockopt(socket.IPPROTO_IP, _IP_FREEBIND, 1)
        listener.bind((host, port))
        listener.listen(BACKLOG)
    except OSError as error:
        listener.close()
        passes = isinstance(error, socket.gaierror) or error.errno == errno.EADDRNOTAVAIL
        raise DeviceError(
            f"{where}: cannot listen on {host} port {port} ({error.strerror}).",
            action="Check the name and the network." if passes else "Stop the other station, or set another port.",
            code="address-absent" if passes else None,
        ) from error
    return listener
