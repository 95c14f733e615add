"""The site of nginx that the package ships, with a real nginx in front of a station, by TLS."""

from __future__ import annotations

import threading
from collections.abc import Iterator
from typing import NamedTuple

import httpx2
import pytest

from tests.api.conftest import Served
from tests.api.held_station import HeldStation
from tests.api.proxy.nginx import before, free_port
from tests.peers.certificates import make_certificate
from vaoi_station.api.access import AccessControl
from vaoi_station.api.audit import AuditLog
from vaoi_station.api.problems import KINDS, Problem
from vaoi_station.files.access_keys import KeyFile


class Proxied(NamedTuple):
    """A station behind nginx, a client of the proxy, and a key that may operate."""

    station: HeldStation
    client: httpx2.Client
    audit: AuditLog
    secret: str
    served: Served

    @property
    def key(self) -> dict[str, str]:
        return {"authorization": f"Bearer {self.secret}"}


@pytest.fixture(scope="module")
def proxied(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Proxied]:
    folder = tmp_path_factory.mktemp("nginx")
    keys, audit = KeyFile(folder / "keys.json"), AuditLog(folder / "audit.jsonl")
    station = HeldStation()
    station.film()
    served = Served(station, access=AccessControl(keys, audit))
    try:
        with before(served.port, None, folder, make_certificate(folder)) as client:
            yield Proxied(station, client, audit, keys.create("tester", ["operate"]).secret, served)
    finally:
        served.stop()
        audit.close()


def test_a_caller_through_the_proxy_needs_a_key_although_the_proxy_is_on_loopback(proxied: Proxied) -> None:
    assert proxied.client.get("/healthz").status_code == 200
    assert proxied.client.get("/api/v1/station").status_code == 401
    assert proxied.client.get("/api/v1/station", headers=proxied.key).status_code == 200
    forged = {"x-forwarded-for": "127.0.0.1", "forwarded": "for=127.0.0.1"}
    assert proxied.client.get("/api/v1/station", headers=forged).status_code == 401


def test_a_prefix_that_a_caller_states_does_not_pass_the_proxy(proxied: Proxied) -> None:
    address = "/api/v1/runs/r000001/components/U1"
    plain = proxied.client.get(address, headers=proxied.key)
    assert plain.json()["views"][0]["url"].startswith(address)
    for prefix in ("/other", "//evil.example"):
        forged = proxied.client.get(address, headers=proxied.key | {"x-forwarded-prefix": prefix})
        assert (forged.status_code, forged.content) == (200, plain.content)


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


def test_the_audit_log_and_limits_count_the_caller_and_not_the_proxy(proxied: Proxied) -> None:
    proxied.client.post("/api/v1/station/disarm", headers=proxied.key | {"x-forwarded-for": "192.0.2.9"})
    assert proxied.audit.newest(1)[0]["address"] == "127.0.0.1", "nginx replaces what a caller states"
    host = {"host": "localhost", **proxied.key}
    port = proxied.served.port
    httpx2.post(f"http://127.0.0.1:{port}/api/v1/station/disarm", headers=host | {"x-forwarded-for": "192.0.2.9"})
    assert proxied.audit.newest(1)[0]["address"] == "192.0.2.9"


def test_a_station_that_does_not_answer_is_a_problem_with_an_action(tmp_path_factory: pytest.TempPathFactory) -> None:
    with before(free_port(), None, tmp_path_factory.mktemp("alone")) as client:
        answer = client.get("/api/v1/station")
    assert (answer.status_code, answer.headers["content-type"]) == (503, "application/problem+json")
    assert answer.headers["retry-after"] == "1"
    assert Problem.model_validate(answer.json()).instance == "/api/v1/station"
    assert answer.json()["title"] == KINDS["busy"][1]
