"""The REST client against a scripted station."""

from __future__ import annotations

import json
import socket
import ssl
import threading
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import ClassVar

import numpy as np
import pytest

from tests.peers.certificates import make_certificate
from tests.peers.web_server import ScriptedHandler, serving
from vaoi_station.demo import client as client_module
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
from vaoi_station.files.caller_credentials import CallerCredentials
from vaoi_station.files.images import encode_png

EVENTS = 'event: heartbeat\ndata: {"state": "idle"}\n\ndata: {"number": 7, "board": "a\u2028b"}\nid: 7\n\n'
PROBLEMS = {
    "list": b"[]",
    "number": b'{"detail": 5, "action": "", "code": "c"}',
    "action": b'{"detail": "No.", "action": {}, "code": "c"}',
    "empty": b"",
}
REPLIES = {
    "/html": b"<!DOCTYPE html><html>Sign in</html>",
    "/truncated": b'{"state": "idl',
    "/list": b'[{"state": "idle"}]',
    "/text": b'"idle"',
    "/latin": b'{"state": "\xe4"}',
    "/deep": b"[" * 100_000,
    "/empty": b"",
}
PICTURE = np.arange(12, dtype=np.uint8).reshape(3, 4)


class ScriptedStation(ScriptedHandler):
    """Serves `/refuse/STATUS`, `/picture`, `/events`, `/nothing`, and `REPLIES`; replies to others with the request."""

    def do_GET(self) -> None:  # noqa: N802  (the name is that of the base class)
        path = self.path.removeprefix("/api/v1")
        if path.startswith("/refuse/"):
            problem = {"detail": "No.", "action": "Wait.", "code": "because"}
            self.send(int(path.removeprefix("/refuse/")), json.dumps(problem).encode())
        elif path == "/broken":
            self.send(500, b"<html>")
        elif path.startswith("/problem/"):
            self.send(409, PROBLEMS[path.removeprefix("/problem/")])
        elif path in REPLIES:
            self.send(200, REPLIES[path])
        elif path in ("/cut", "/cut-refusal"):
            self.send(200 if path == "/cut" else 500, b'{"state": "id', length=100)
        elif path == "/key":
            self.send(200, json.dumps({"key": self.headers.get("Authorization")}).encode())
        elif path == "/moved":
            self.send_response(302)
            self.send_header("Location", "/api/v1/key")
            self.end_headers()
        elif path == "/nothing":
            self.send(204, b"")
        elif path == "/picture":
            self.send(200, encode_png(PICTURE))
        elif path == "/page":
            self.send(200, b"hello")
        elif path.startswith("/events"):
            self.send(200, EVENTS.encode())
        else:
            self.echo()

    def do_POST(self) -> None:  # noqa: N802  (the name is that of the base class)
        self.echo()

    do_PUT = do_POST  # noqa: N815  (the names are the base class's)

    def echo(self) -> None:
        body = self.rfile.read(int(self.headers.get("Content-Length") or 0))
        self.send(200, json.dumps({"request": [self.command, self.path, body.decode()]}).encode())


@pytest.fixture(scope="module")
def address() -> Iterator[str]:
    with serving(ScriptedStation) as address:
        yield address


@pytest.fixture
def client(address: str, monkeypatch: pytest.MonkeyPatch) -> Client:
    monkeypatch.setenv("http_proxy", "http://127.0.0.1:9")
    return Client(address)


@pytest.mark.parametrize(
    ("status", "kind"),
    [
        (404, NotFoundError),
        (409, StateError),
        (410, GoneError),
        (401, InputError),
        (403, InputError),
        (422, InputError),
        (503, BusyError),
        (500, InternalError),
    ],
)
def test_refusals_are_raised_as_the_errors_of_the_station(client: Client, status: int, kind: type[VaoiError]) -> None:
    with pytest.raises(kind) as refusal:
        client.get(f"/refuse/{status}")
    assert (refusal.value.message, refusal.value.action, refusal.value.code) == ("No.", "Wait.", "because")


@pytest.mark.parametrize("path", REPLIES)
def test_garbage_is_a_device_error_with_the_address(client: Client, path: str) -> None:
    with pytest.raises(
        DeviceError, match=rf"http://127\.0\.0\.1:\d+/api/v1{path}: the station replied with"
    ) as refused:
        client.get(path)
    assert "Check that a station of this version runs at this address" in refused.value.action
    assert refused.value.code == "unusable-reply"


def test_the_key_is_sent_with_every_request_and_to_no_other_address(address: str) -> None:
    client = Client(address, CallerCredentials("vaoi_1_2"))
    assert client.get("/key")["key"] == "Bearer vaoi_1_2"
    assert Client(address).get("/key")["key"] is None
    with pytest.raises(DeviceError, match="status 302 without problem details"):
        client.get("/moved")


class LosesReplies(ScriptedHandler):
    """Ends the connection in place of the first replies; then replies with the keys of all requests."""

    lost = 2
    keys: ClassVar[list[str | None]] = []

    def do_POST(self) -> None:  # noqa: N802  (the name is that of the base class)
        self.rfile.read(int(self.headers.get("Content-Length") or 0))
        self.keys.append(self.headers.get("Idempotency-Key"))
        if len(self.keys) == self.lost + 1:
            problem = {"detail": "The command is still under way.", "action": "", "code": "request-under-way"}
            self.send(409, json.dumps(problem).encode())
        elif len(self.keys) > self.lost:
            self.send(200, json.dumps({"keys": self.keys}).encode())
        else:
            self.close_connection = True


def test_a_command_is_repeated_with_its_key_where_its_reply_was_lost(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(LosesReplies, "keys", [])
    with serving(LosesReplies) as address:
        keys = Client(address).post("/station/arm")["keys"]
        assert len(keys) == 4
        assert len(set(keys)) == 1
        assert keys[0]
        LosesReplies.keys.clear()
        monkeypatch.setattr(LosesReplies, "lost", client_module.ATTEMPTS)
        with pytest.raises(DeviceError, match="does not reply"):
            Client(address).post("/station/arm")
    assert len(LosesReplies.keys) == client_module.ATTEMPTS


def test_a_certificate_that_is_not_trusted_comes_with_what_to_do(tmp_path: Path) -> None:
    made = make_certificate(tmp_path)
    context = ssl.SSLContext(ssl.PROTOCOL_TLS_SERVER)
    context.load_cert_chain(*made)
    with socket.create_server(("127.0.0.1", 0)) as listening:

        def greet() -> None:
            with listening.accept()[0] as connection, suppress(OSError):
                context.wrap_socket(connection, server_side=True)

        server = threading.Thread(target=greet)
        server.start()
        with pytest.raises(DeviceError, match="certificate") as refused:
            Client(f"https://127.0.0.1:{listening.getsockname()[1]}").get("/station")
        server.join()
    assert "--ca" in refused.value.action
