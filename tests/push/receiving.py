"""Receivers of webhooks on loopback: a good one that keeps what it got, and hostile ones that send chosen bytes."""

from __future__ import annotations

import json
import queue
import socket
import ssl
import threading
from collections.abc import Callable, Iterator, Mapping
from contextlib import contextmanager, suppress
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any, NamedTuple

from tests.peers.certificates import Certificate

WAIT_S = 30.0


class Received(NamedTuple):
    """One request that arrived."""

    headers: Mapping[str, str]
    body: bytes

    @property
    def document(self) -> Any:
        return json.loads(self.body)


class Receiver:
    """A receiver that answers with `status`, or with what `answer` returns for a request."""

    def __init__(self, url: str) -> None:
        self.url, self.status, self.headers = url, 204, dict[str, str]()
        self.got: queue.Queue[Received] = queue.Queue()
        self.answer: Callable[[Received], int] = lambda _: self.status

    def next(self) -> Received:
        """Wait for the next request."""
        return self.got.get(timeout=WAIT_S)


@contextmanager
def receiver(certificate: Certificate | None = None) -> Iterator[Receiver]:
    """Run a receiver."""

    class Handler(BaseHTTPRequestHandler):
        def do_POST(self) -> None:
            body = self.rfile.read(int(self.headers["Content-Length"]))
            request = Received({k.lower(): v for k, v in self.headers.items()}, body)
            status = made.answer(request)
            self.send_response(status)
            for name, value in made.headers.items():
                self.send_header(name, value)
            self.end_headers()
            made.got.put(request)

        def log_message(self, *_: object) -> None: ...

    server = ThreadingHTTPServer(("127.0.0.1", 0), Handler)
    scheme = "http"
    if certificate is not None:
        context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
        context.load_cert_chain(certificate.certificate, certificate.private_key)
        server.socket = context.wrap_socket(server.socket, server_side=True, do_handshake_on_connect=False)
        scheme = "https"
    made = Receiver(f"{scheme}://127.0.0.1:{server.server_port}/hook?a=1")
    server.handle_error = lambda *_: None  # type: ignore[method-assign]
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02}, daemon=True)
    thread.start()
    try:
        yield made
    finally:
        server.shutdown()
        server.server_close()
        thread.join()


@contextmanager
def peer(talk: Callable[[socket.socket], object]) -> Iterator[str]:
    """Yield the URL of a server that does `talk` with each connection, after it has read the request."""
    listener = socket.create_server(("127.0.0.1", 0))

    def serve() -> None:
        with suppress(OSError):
            while True:
                connection, _ = listener.accept()
                with connection, suppress(OSError):
                    connection.settimeout(WAIT_S)
                    connection.recv(65536)
                    talk(connection)

    thread = threading.Thread(target=serve, daemon=True)
    thread.start()
    try:
        yield f"http://127.0.0.1:{listener.getsockname()[1]}/"
    finally:
        # `close` alone does not wake a thread that waits in accept.
        with suppress(OSError):
            listener.shutdown(socket.SHUT_RDWR)
        listener.close()
        thread.join()
