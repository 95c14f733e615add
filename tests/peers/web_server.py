"""A web server on loopback with scripted replies."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from contextlib import contextmanager
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any


class ScriptedHandler(BaseHTTPRequestHandler):
    """Base of scripted handlers: sends replies and prints nothing. A subclass adds `do_GET` and the like."""

    def send(self, status: int, content: bytes, length: int | None = None, retry_after: str | None = None) -> None:
        """Send a reply; `length` is the length that it declares, by default the true one."""
        self.send_response(status)
        if retry_after is not None:
            self.send_header("Retry-After", retry_after)
        self.send_header("Content-Length", str(len(content) if length is None else length))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: Any) -> None:
        return


@contextmanager
def serving(handler: type[ScriptedHandler]) -> Iterator[str]:
    """Serve with a handler while the context is entered, at the address that is returned."""
    server = ThreadingHTTPServer(("127.0.0.1", 0), handler)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    try:
        yield f"http://127.0.0.1:{server.server_address[1]}"
    finally:
        server.shutdown()
        thread.join()
        server.server_close()
