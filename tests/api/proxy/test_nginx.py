"""The settings of nginx in docs/SECURITY.md, with a real nginx in front of a station, by TLS."""

from __future__ import annotations

import re
import socket
import ssl
import subprocess
import threading
from collections.abc import Iterator
from pathlib import Path
from typing import NamedTuple

import httpx2
import pytest

from tests.api.conftest import Served
from tests.api.held_station import HeldStation
from tests.needs import need, program
from tests.peers.certificates import make_certificate
from vaoi_station.api.access.access_control import AccessControl
from vaoi_station.api.access.audit import AuditLog
from vaoi_station.files.access_keys import KeyFile

FRAME = """
daemon off; master_process off; pid {folder}/pid; error_log stderr warn;
events {{ worker_connections 256; }}
http {{
  access_log off;
  client_body_temp_path {folder}; proxy_temp_path {folder}; fastcgi_temp_path {folder};
  uwsgi_temp_path {folder}; scgi_temp_path {folder};
  server {{
    listen 127.0.0.1:{port} ssl;
    ssl_certificate {certificate}; ssl_certificate_key {key};
    {location}
  }}
}}
"""


class Proxied(NamedTuple):
    """A station behind nginx, a client of the proxy, and a key that may operate."""

    station: HeldStation
    client: httpx2.Client
    audit: AuditLog
    secret: str

    @property
    def key(self) -> dict[str, str]:
        return {"authorization": f"Bearer {self.secret}"}


def documented() -> str:
    """Return the settings from the document."""
    text = (Path(__file__).parents[3] / "docs" / "SECURITY.md").read_text(encoding="utf-8")
    (found,) = re.findall(r"```\n(location / \{.*?\n\})\n```", text, re.DOTALL)
    return str(found)


@pytest.fixture(scope="module")
def proxied(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Proxied]:
    need("nginx")
    folder = tmp_path_factory.mktemp("nginx")
    keys, audit = KeyFile(folder / "keys.json"), AuditLog(folder / "audit.jsonl")
    station = HeldStation()
    station.film()
    served = Served(station, access=AccessControl(keys, audit))
    made = make_certificate(folder)
    with socket.create_server(("127.0.0.1", 0)) as free:
        port = free.getsockname()[1]
    location = documented().replace("127.0.0.1:8350", f"127.0.0.1:{served.port}")
    names = {"folder": folder, "port": port, "certificate": made.certificate, "key": made.private_key}
    (folder / "nginx.conf").write_text(FRAME.format(location=location, **names))
    command = [str(program("nginx")), "-e", "stderr", "-p", str(folder), "-c", str(folder / "nginx.conf")]
    server = subprocess.Popen(command, stderr=subprocess.PIPE, text=True)
    trusted = ssl.create_default_context(cafile=str(made.certificate))
    client = httpx2.Client(base_url=f"https://localhost:{port}", verify=trusted, timeout=20)
    try:
        while True:
            assert server.poll() is None, server.stderr and server.stderr.read()
            try:
                client.get("/healthz")
                break
            except httpx2.TransportError:
                continue
        yield Proxied(station, client, audit, keys.create("tester", ["operate"]).secret)
    finally:
        client.close()
        server.terminate()
        server.communicate()
        served.stop()
        audit.close()


def test_a_caller_through_the_proxy_needs_a_key_although_the_proxy_is_on_loopback(proxied: Proxied) -> None:
    assert proxied.client.get("/healthz").status_code == 200
    assert proxied.client.get("/api/v1/station").status_code == 401
    assert proxied.client.get("/api/v1/station", headers=proxied.key).status_code == 200
    forged = {"x-forwarded-for": "127.0.0.1", "forwarded": "for=127.0.0.1"}
    assert proxied.client.get("/api/v1/station", headers=forged).status_code == 401


def test_commands_and_logins_of_the_page_work_through_the_proxy(proxied: Proxied) -> None:
    origin = {"origin": str(proxied.client.base_url).rstrip("/")}
    login = proxied.client.post("/api/v1/session", json={"key": proxied.secret}, headers=origin)
    assert login.status_code == 200
    assert "Secure" in login.headers["set-cookie"], "X-Forwarded-Proto says that the browser speaks TLS"
    arm = "/api/v1/station/arm?board_type=demo-board"
    assert proxied.client.post(arm, headers=origin).status_code == 200
    assert proxied.client.post(arm, headers={"origin": "https://evil.example"}).status_code == 403
    proxied.client.cookies.clear()
    # A foreign page is refused before its cookie is read.
    assert [(e["key"], e["status"]) for e in proxied.audit.newest(2)] == [("none", 403), ("tester", 200)]


def test_pictures_long_polls_and_events_pass_the_proxy_at_once(proxied: Proxied) -> None:
    run = proxied.client.get("/api/v1/runs/latest", headers=proxied.key).json()["id"]
    picture = proxied.client.get(f"/api/v1/runs/{run}/frames/0/0?format=raw", headers=proxied.key)
    assert len(picture.content) == 320 * 240
    with proxied.client.stream("GET", "/api/v1/events", headers=proxied.key) as events:
        lines = events.iter_lines()
        assert next(lines).startswith("event: heartbeat")  # would wait for more bytes if the proxy collected them
        poll: list[httpx2.Response] = []
        address = f"/api/v1/runs/next?after={run}&timeout=20"
        waiting = threading.Thread(target=lambda: poll.append(proxied.client.get(address, headers=proxied.key)))
        waiting.start()
        following = proxied.station.film()
        assert any(following in line for line in lines if line.startswith("data:"))
        waiting.join()
    assert poll[0].json()["id"] == following


def test_a_request_with_two_lengths_does_not_pass(proxied: Proxied) -> None:
    address = proxied.client.base_url
    context = ssl._create_unverified_context()
    with (
        socket.create_connection(("127.0.0.1", address.port or 0), 20) as plain,
        context.wrap_socket(plain, server_hostname="localhost") as s,
    ):
        head = f"POST /api/v1/station/disarm HTTP/1.1\r\nHost: localhost\r\nAuthorization: Bearer {proxied.secret}\r\n"
        s.sendall(
            head.encode() + b"Content-Length: 4\r\nTransfer-Encoding: chunked\r\n\r\n0\r\n\r\nGET /x HTTP/1.1\r\n\r\n"
        )
        answer = b"".join(iter(lambda: s.recv(65536), b""))
    assert answer.startswith(b"HTTP/1.1 400")
    assert answer.count(b"HTTP/1.1 ") == 1
