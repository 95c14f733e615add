"""A web server in a thread: it serves, stops, and reports an unexpected end."""

from __future__ import annotations

import socket
import ssl
import subprocess
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path

import httpx2
import pytest
from fastapi import FastAPI

from vaoi_station.api.listener.connections import ConnectionLimits
from vaoi_station.api.web_server import WebServer, open_listener, tls_context
from vaoi_station.errors import DeviceError, InputError, InternalError


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


def test_it_serves_at_its_address_until_it_is_stopped(server: WebServer, ended: threading.Event) -> None:
    assert httpx2.get(server.address, timeout=20).json() == "served"
    assert not ended.is_set()
    server.stop()
    assert ended.wait(20)
    server.check()


# uvicorn ends its thread with SystemExit when the application does not start.
@pytest.mark.filterwarnings("ignore::pytest.PytestUnhandledThreadExceptionWarning")
def test_an_unexpected_end_is_reported(ended: threading.Event) -> None:
    app = FastAPI(on_startup=[lambda: 1 / 0])
    with open_listener("127.0.0.1", 0, "[api]") as listener:
        server = WebServer(app, listener, ended.set)
        server.start()
        assert ended.wait(20)
        with pytest.raises(InternalError, match="ended unexpectedly"):
            server.check()
        server.stop()


def test_a_port_in_use_is_refused_with_the_source_of_the_address() -> None:
    with open_listener("127.0.0.1", 0, "--port") as listener:
        port = listener.getsockname()[1]
        with pytest.raises(DeviceError, match=f"--port: cannot listen on 127.0.0.1 port {port}") as refusal:
            open_listener("127.0.0.1", port, "--port")
    assert "another port" in refusal.value.action


@pytest.fixture
def certificate(tmp_path: Path) -> tuple[Path, Path]:
    """A certificate for 127.0.0.1 that it has signed itself, and its private key."""
    made, key = tmp_path / "cert.pem", tmp_path / "key.pem"
    command = "openssl req -x509 -newkey ec -pkeyopt ec_paramgen_curve:P-256 -nodes -days 2 -subj /CN=station"
    names = ["-addext", "subjectAltName=IP:127.0.0.1", "-keyout", str(key), "-out", str(made)]
    subprocess.run([*command.split(), *names], check=True, capture_output=True)
    return made, key


def test_it_speaks_tls_and_ends_handshakes_that_do_not_end(
    ended: threading.Event, certificate: tuple[Path, Path]
) -> None:
    app = FastAPI()
    app.get("/")(lambda: "served")
    limits = ConnectionLimits(per_address=8, handshake_s=1.0)
    with open_listener("127.0.0.1", 0, "[api]") as listener:
        server = WebServer(app, listener, ended.set, limits, tls_context(*certificate))
        server.start()
        assert server.address.startswith("https://")
        trusted = ssl.create_default_context(cafile=str(certificate[0]))
        port = listener.getsockname()[1]
        silent = [socket.create_connection(("127.0.0.1", port), 20) for _ in range(20)]
        assert httpx2.get(server.address, verify=trusted, timeout=20).json() == "served"
        for s in silent:
            with s, suppress(ConnectionResetError):
                assert s.recv(1) == b""
        server.stop()


def test_a_certificate_that_cannot_be_used_is_refused(certificate: tuple[Path, Path], tmp_path: Path) -> None:
    with pytest.raises(InputError, match=r"\[api\] certificate .*cannot be used"):
        tls_context(certificate[0], tmp_path / "absent.pem")
    with pytest.raises(InputError, match="PEM"):
        tls_context(certificate[1], certificate[1])
