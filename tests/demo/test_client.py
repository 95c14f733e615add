"""The REST client against a scripted station."""

from __future__ import annotations

import json
import socket
import threading
from collections.abc import Iterator
from http.server import BaseHTTPRequestHandler, ThreadingHTTPServer
from typing import Any

import numpy as np
import pytest

from vaoi_station.demo.client import Client
from vaoi_station.errors import (
    BusyError,
    DeviceError,
    GoneError,
    InputError,
    InternalError,
    NotFoundError,
    StateError,
    VaoiError,
)
from vaoi_station.files.images import encode_png

PICTURE = np.arange(12, dtype=np.uint8).reshape(3, 4)


class ScriptedStation(BaseHTTPRequestHandler):
    """Serves `/refuse/STATUS`, `/picture`, `/events`, `/nothing`; replies to every other request with the request."""

    def do_GET(self) -> None:
        path = self.path.removeprefix("/api/v1")
        if path.startswith("/refuse/"):
            problem = {"detail": "No.", "action": "Wait.", "code": "because"}
            self.send(int(path.removeprefix("/refuse/")), json.dumps(problem).encode())
        elif path == "/broken":
            self.send(500, b"<html>")
        elif path == "/nothing":
            self.send(204, b"")
        elif path == "/picture":
            self.send(200, encode_png(PICTURE))
        elif path == "/page":
            self.send(200, b"hello")
        elif path.startswith("/events"):
            self.send(200, b'event: heartbeat\ndata: {"state": "idle"}\n\ndata: {"number": 7}\nid: 7\n\n')
        else:
            self.echo()

    def do_POST(self) -> None:
        self.echo()

    do_PUT = do_POST  # noqa: N815  (the names are the base class's)

    def echo(self) -> None:
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        self.send(200, json.dumps([self.command, self.path, body.decode()]).encode())

    def send(self, status: int, content: bytes) -> None:
        self.send_response(status)
        self.send_header("Content-Length", str(len(content)))
        self.end_headers()
        self.wfile.write(content)

    def log_message(self, *_: Any) -> None:
        return


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    server = ThreadingHTTPServer(("127.0.0.1", 0), ScriptedStation)
    thread = threading.Thread(target=server.serve_forever, kwargs={"poll_interval": 0.02})
    thread.start()
    yield f"http://127.0.0.1:{server.server_address[1]}"
    server.shutdown()
    thread.join()
    server.server_close()


@pytest.fixture
def client(address: str, monkeypatch: pytest.MonkeyPatch) -> Client:
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")
    return Client(address)


def test_requests(client: Client) -> None:
    assert client.get("/runs", limit=3, before=None) == ["GET", "/api/v1/runs?limit=3", ""]
    assert client.get("/api/v1/runs/r1") == ["GET", "/api/v1/runs/r1", ""]
    assert client.post("/station/arm", runs=1) == ["POST", "/api/v1/station/arm", '{"runs": 1}']
    assert client.put("/runs/r1/hold", holder="me") == ["PUT", "/api/v1/runs/r1/hold?holder=me", ""]
    assert client.get("/nothing") is None


def test_pictures(client: Client) -> None:
    content, pixels = client.picture("/picture")
    assert content.startswith(b"\x89PNG")
    assert np.array_equal(pixels, PICTURE)
    with pytest.raises(InternalError, match="not a picture"):
        client.picture("/page")


def test_events(client: Client) -> None:
    assert list(client.messages()) == [{"state": "idle"}, {"number": 7}]


@pytest.mark.parametrize(
    ("status", "kind"),
    [
        (404, NotFoundError),
        (409, StateError),
        (410, GoneError),
        (422, InputError),
        (503, BusyError),
        (500, InternalError),
    ],
)
def test_refusals_are_raised_as_the_errors_of_the_station(client: Client, status: int, kind: type[VaoiError]) -> None:
    with pytest.raises(kind) as refusal:
        client.get(f"/refuse/{status}")
    assert (refusal.value.message, refusal.value.action, refusal.value.code) == ("No.", "Wait.", "because")


def test_reply_without_problem_details_is_an_internal_error(client: Client) -> None:
    with pytest.raises(InternalError, match=r"replied 500: b'<html>'"):
        client.get("/broken")


def test_absent_station_is_a_device_error() -> None:
    with socket.create_server(("127.0.0.1", 0)) as free:
        address = f"http://127.0.0.1:{free.getsockname()[1]}"
    with pytest.raises(DeviceError, match="does not reply"):
        Client(address).get("/station")
