"""A web server in a thread: it serves, stops, and reports an unexpected end."""

from __future__ import annotations

import socket
import ssl
import subprocess
import sys
import threading
import time
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from statistics import median
from typing import Any

import httpx2
import pytest
from fastapi import FastAPI

from tests.peers.certificates import Certificate, make_certificate
from vaoi_station.api import web_server as module
from vaoi_station.api.certificate import CertificateFiles
from vaoi_station.api.web_server import WebServer, open_listener
from vaoi_station.errors import DeviceError


@pytest.fixture
def ended() -> threading.Event:
    return threading.Event()


@pytest.fixture
def server(ended: threading.Event) -> Iterator[WebServer]:
    app = FastAPI()
    app.get("/")(lambda: "served")
    with open_listener("127.0.0.1", 0, "[api]") as listener:
        made = WebServer(app, listener, ended.set)
        made.start()
        yield made
        made.stop()


def test_a_port_in_use_is_refused_with_the_source_of_the_address() -> None:
    with open_listener("127.0.0.1", 0, "--port") as listener:
        port = listener.getsockname()[1]
        with pytest.raises(DeviceError, match=f"--port: cannot listen on 127.0.0.1 port {port}") as refusal:
            open_listener("127.0.0.1", port, "--port")
    assert "another port" in refusal.value.action


@pytest.fixture
def certificate(tmp_path: Path) -> Certificate:
    return make_certificate(tmp_path)


def test_it_speaks_tls_while_other_connections_are_silent(ended: threading.Event, certificate: Certificate) -> None:
    app = FastAPI()
    app.get("/")(lambda: "served")
    with open_listener("127.0.0.1", 0, "[api]") as listener:
        server = WebServer(app, listener, ended.set, CertificateFiles(*certificate))
        server.start()
        assert server.address.startswith("https://")
        trusted = ssl.create_default_context(cafile=str(certificate[0]))
        port = listener.getsockname()[1]
        silent = [socket.create_connection(("127.0.0.1", port), 20) for _ in range(20)]
        assert httpx2.get(server.address, verify=trusted, timeout=20).json() == "served"
        for s in silent:
            s.close()
        server.stop()


def test_a_renewed_certificate_is_used_for_new_connections_without_a_restart(
    ended: threading.Event, certificate: Certificate, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.setattr(module, "RENEW_S", 0.0)
    app = FastAPI()
    app.get("/")(lambda: "served")
    with open_listener("127.0.0.1", 0, "[api]") as listener:
        server = WebServer(app, listener, ended.set, CertificateFiles(*certificate))
        server.start()
        with httpx2.Client(verify=ssl.create_default_context(cafile=str(certificate[0])), timeout=20) as kept:
            assert kept.get(server.address).json() == "served"
            renewed = make_certificate(tmp_path, "renewed")
            trusted = ssl.create_default_context(cafile=str(renewed.certificate))
            renewed.certificate.replace(certificate.certificate)
            renewed.private_key.replace(certificate.private_key)
            while not _trusts(trusted, server.address):
                assert kept.get(server.address).json() == "served"  # also keeps the files from being read for nothing
        server.stop()


def test_an_idle_tls_connection_does_not_delay_the_stop(
    ended: threading.Event, certificate: Certificate, monkeypatch: pytest.MonkeyPatch
) -> None:
    # Every time limit that could end the connection is longer than this test.
    monkeypatch.setattr(module, "HTTP_GRACE_S", 600.0)
    monkeypatch.setattr(module, "LINGER_S", 0.2)
    app = FastAPI()
    app.get("/")(lambda: "served")
    trusted = ssl.create_default_context(cafile=str(certificate[0]))
    with open_listener("127.0.0.1", 0, "[api]") as listener:
        server = WebServer(app, listener, ended.set, CertificateFiles(*certificate), idle_s=600)
        server.start()
        # The caller keeps the connection for its next request, and reads nothing until then.
        plain = socket.create_connection(listener.getsockname(), 20)
        with trusted.wrap_socket(plain, server_hostname="127.0.0.1") as kept:
            kept.sendall(b"GET / HTTP/1.1\r\nHost: 127.0.0.1\r\n\r\n")
            received = b""
            while b'"served"' not in received:
                received += kept.recv(4096)
            server._server.should_exit = True
            server._stop_requested = True
            server.thread.expect_end()
            assert ended.wait(20)
            assert kept.recv(1) == b"", "the end of TLS was sent"
        server.stop()


REQUEST = b"GET /web/icon.svg HTTP/1.1\r\nHost: localhost\r\n\r\n"
HALF = b"GET /healthz HTTP/1.1\r\n"


def until_closed(s: socket.socket) -> bytes:
    """Read until the station closes the connection."""
    received = bytearray()
    with suppress(ConnectionResetError):
        while got := s.recv(65536):
            received += got
    return bytes(received)


@pytest.fixture
def impatient(station: Any, serve: Any) -> Iterator[Any]:
    """A service that waits one second for a request."""
    made = serve(station, idle_s=1)
    yield made
    made.stop()


@pytest.mark.parametrize(
    "sent",
    [HALF, REQUEST, REQUEST + HALF, REQUEST.replace(b"\r\n\r\n", b"\r\nContent-Length: 1000000\r\n\r\n")],
    ids=["half a head", "a request", "a request and a half", "a body that does not come"],
)
def test_a_connection_without_a_request_is_closed(impatient: Any, sent: bytes) -> None:
    with socket.create_connection(("127.0.0.1", impatient.port), 20) as s:
        s.sendall(sent)
        assert (b"200 OK" in until_closed(s)) == sent.startswith(REQUEST[:16])


def test_a_caller_that_does_not_read_is_disconnected(station: Any, serve: Any, monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "STALL_S", 1.0)
    served = serve(station)
    served.app.get("/large")(lambda: "x" * 8_000_000)
    with socket.socket() as s:
        s.setsockopt(socket.SOL_SOCKET, socket.SO_RCVBUF, 4096)
        s.settimeout(20)
        s.connect(("127.0.0.1", served.port))
        s.sendall(b"GET /large HTTP/1.1\r\nHost: localhost\r\n\r\n")
        assert s.recv(1) == b"H"
        while len(served._server._server.server_state.connections) > 1:
            served.client.get("/healthz")
        assert len(until_closed(s)) < 8_000_000
    served.stop()


def test_an_answer_on_a_kept_alive_connection_takes_no_longer_than_on_a_new_one(served: Any) -> None:
    """With Nagle's algorithm it takes 40 ms, in which the caller's kernel delays its acknowledgement."""
    fresh, kept = [], []
    for _ in range(15):
        with socket.create_connection(("127.0.0.1", served.port), 20) as s:
            fresh.append(exchange(s))
    with socket.create_connection(("127.0.0.1", served.port), 20) as s:
        kept = [exchange(s) for _ in range(30)][10:]
    assert median(kept) < 5 * median(fresh)


def exchange(s: socket.socket) -> float:
    """Send one request, read the whole answer, and return the time in s."""
    begun = time.perf_counter()
    s.sendall(REQUEST)
    received = b""
    while b"\r\n\r\n" not in received:
        received += s.recv(65536)
    head, _, body = received.partition(b"\r\n\r\n")
    length = int(head.lower().partition(b"content-length: ")[2].partition(b"\r\n")[0])
    while len(body) < length:
        body += s.recv(65536)
    return time.perf_counter() - begun


def _trusts(context: ssl.SSLContext, address: str) -> bool:
    try:
        return httpx2.get(address, verify=context, timeout=20).is_success
    except httpx2.ConnectError:
        return False


LEFT = """
import os, threading, time
from fastapi import FastAPI
from fastapi.testclient import TestClient
import httpx2
from vaoi_station.api import web_server
from vaoi_station.api.web_server import WebServer, open_listener

web_server.HTTP_GRACE_S = 0.1
app, begun = FastAPI(), threading.Event()

@app.get("/")
def never_ends():
    begun.set()
    threading.Event().wait()

listener = open_listener("127.0.0.1", 0, "test")
server = WebServer(app, listener, lambda: None)
server.start()
threading.Thread(target=httpx2.get, args=(server.address,), daemon=True).start()
begun.wait()
server.stop()
print("stopped", flush=True)
server.end_process_if_left()
os._exit(7)
"""


def test_a_request_that_does_not_end_does_not_abort_the_process_at_its_end() -> None:
    done = subprocess.run([sys.executable, "-c", LEFT], capture_output=True, text=True, timeout=100, check=False)
    assert (done.returncode, done.stdout) == (0, "stopped\n"), done.stderr
    assert "did not end within 0.2 s" in done.stderr
