"""Who may do what: by key, by login, from loopback, through a proxy; and which scope each address needs."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from contextlib import ExitStack
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from tests.api.conftest import Served
from tests.api.held.setup_files import setup_files
from vaoi_station.api.access import SESSION_S, AccessControl, Sessions, scope_needed
from vaoi_station.api.app import create_app
from vaoi_station.api.audit import AuditLog
from vaoi_station.files.access_keys import KeyFile

MakeClient = Callable[..., TestClient]


@pytest.fixture
def keys(tmp_path: Path) -> KeyFile:
    return KeyFile(tmp_path / "keys.json")


@pytest.fixture
def audit(tmp_path: Path) -> Iterator[AuditLog]:
    log = AuditLog(tmp_path / "audit.jsonl")
    yield log
    log.close()


@pytest.fixture
def call_from(station: Any, keys: KeyFile, audit: AuditLog) -> Iterator[MakeClient]:
    """Return a function that makes a client with an address, and perhaps a key."""
    access = AccessControl(keys, audit)
    app = create_app(station, ["testserver"], access)
    with ExitStack() as opened:
        opened.enter_context(TestClient(app))

        def made(address: str, secret: str | None = None, open_loopback: bool = True) -> TestClient:
            access._open_loopback = open_loopback
            headers = {} if secret is None else {"authorization": f"Bearer {secret}"}
            return TestClient(app, client=(address, 5000), headers=headers, raise_server_exceptions=False)

        yield made


ARM = "/api/v1/station/arm?board_type=demo-board"
OUTSIDE, INSIDE = "192.0.2.7", "127.0.0.1"


def test_from_outside_nothing_works_without_a_key_but_page_and_health(call_from: Any, station: Any) -> None:
    client = call_from(OUTSIDE)
    assert client.get("/").status_code == client.get("/healthz").status_code == 200
    for answer in (client.get("/api/v1/station"), client.post(ARM), client.get("/metrics")):
        assert (answer.status_code, answer.json()["code"]) == (401, "no-key")
        assert answer.headers["www-authenticate"].startswith("Bearer")
    assert station.armed is None


def test_a_key_permits_its_scopes_only(call_from: Any, keys: KeyFile) -> None:
    operator = call_from(OUTSIDE, keys.create("operator", ["operate"]).secret)
    assert operator.get("/api/v1/station").status_code == 200
    assert operator.post(ARM).status_code == 200
    for refused in (operator.delete("/api/v1/board-types/demo-board"), operator.get("/api/v1/keys")):
        assert (refused.status_code, refused.json()["code"]) == (403, "missing-scope")


def test_a_wrong_key_is_refused_from_loopback_too(call_from: Any) -> None:
    assert call_from(INSIDE, "vaoi_000000000000_wrong").get("/api/v1/station").status_code == 401


def test_loopback_can_be_closed(call_from: Any) -> None:
    assert call_from(INSIDE, open_loopback=False).get("/api/v1/station").status_code == 401


@pytest.mark.parametrize("header", ["X-Forwarded-For", "Forwarded", "Via", "X-Real-IP"])
def test_a_request_that_a_proxy_passed_on_is_not_from_loopback(call_from: Any, header: str) -> None:
    assert call_from(INSIDE).get("/api/v1/station", headers={header: "127.0.0.1"}).status_code == 401


def test_commands_and_refusals_are_in_the_audit_log_with_the_name_of_the_key(
    call_from: Any, keys: KeyFile, audit: AuditLog
) -> None:
    made = keys.create("operator", ["operate"])
    call_from(OUTSIDE, made.secret).post(ARM)
    call_from(OUTSIDE, made.secret).get("/api/v1/station")
    call_from(OUTSIDE).post(ARM)
    call_from(INSIDE).post("/api/v1/station/disarm")
    entries = [(e["key"], e["address"], e["path"], e["status"]) for e in audit.newest(10)]
    assert entries == [
        ("loopback", INSIDE, "/api/v1/station/disarm", 200),
        ("none", OUTSIDE, "/api/v1/station/arm", 401),
        ("operator", OUTSIDE, "/api/v1/station/arm", 200),
    ]
    assert made.secret not in audit.path.read_text()


def test_an_open_event_stream_ends_when_its_key_is_revoked(keys: KeyFile, audit: AuditLog, station: Any) -> None:
    access = AccessControl(keys, audit, open_loopback=False)
    served = Served(station, access=access)
    try:
        key = {"authorization": f"Bearer {keys.create('reader', ['read']).secret}"}
        with served.client.stream("GET", "/api/v1/events", headers=key) as events:
            lines = events.iter_lines()
            assert next(lines).startswith("event: heartbeat")
            keys.rotate("reader")
            station.publish("station", "something that the old key must not see")
            assert not [line for line in lines if "must not see" in line]
    finally:
        served.stop()


EXPECTED = {
    "admin": {
        "POST /keys",
        "POST /settings/check",
        "PUT /settings",
        "POST /calibration/marks",
        "DELETE /calibration/trial",
        "POST /calibration/trial",
        "POST /calibration/trial/accept",
        "POST /cameras/search/address",
        "POST /cameras/{camera}/exchange",
        "POST /cameras/{camera}/exchange/confirm",
        "POST /keys/{name}/rotate",
        "DELETE /keys/{name}",
        "POST /station/set-aside/{file}/acknowledge",
    },
    "operate": {
        "POST /station/arm",
        "POST /station/disarm",
        "POST /runs/{run}/clamped",
        "POST /runs/{run}/release",
        "PUT /runs/{run}/hold",
        "DELETE /runs/{run}/hold",
        "PUT /runs/{run}/pin",
        "DELETE /runs/{run}/pin",
        "PUT /runs/{run}/decision",
        "PUT /runs/{run}/identity/next-machine",
        "POST /orders",
        "PATCH /orders/{order}",
        "DELETE /orders/{order}",
        "DELETE /neighbours/boards/{board_id}",
    },
    "teach": {
        "POST /cameras/{camera}/trial",
        "DELETE /cameras/{camera}/trial",
        "POST /board-types/{name}/correct",
        "POST /board-types/{name}/limits/check",
        "POST /board-types/{name}/program/check",
        "POST /board-data/previews",
        "PUT /board-data/previews/{preview}",
        "DELETE /board-data/previews/{preview}",
        "POST /board-data/previews/{preview}/confirm",
        "PUT /board-types/{name}",
        "DELETE /board-types/{name}",
        "PUT /runs/{run}/good",
        "DELETE /runs/{run}/good",
        "PUT /board-types/{name}/reference",
        "DELETE /board-types/{name}/reference",
        "POST /board-types/{name}/revisions/{revision}/restore",
        "PUT /board-types/{name}/method",
        "PUT /board-types/{name}/state",
        "PUT /board-types/{name}/limits",
        "DELETE /board-types/{name}/method",
    },
    None: {"POST /session", "DELETE /session"},
}
"""Every command. A new one needs the scope admin until it is listed."""


def test_every_command_has_its_scope(station: Any, tmp_path: Path) -> None:
    audit = AuditLog(tmp_path / "audit.jsonl")
    access = AccessControl(KeyFile(tmp_path / "keys.json"), audit)
    paths = create_app(station, (), access, files=setup_files(tmp_path)).openapi()["paths"]
    audit.close()
    found: dict[Any, set[str]] = {scope: set() for scope in EXPECTED}
    for path, operations in paths.items():
        for method in operations:
            if method != "get":
                needed = scope_needed(method.upper(), path.replace("{", "").replace("}", ""))
                found[needed].add(f"{method.upper()} {path.removeprefix('/api/v1')}")
    assert found == EXPECTED


@pytest.mark.parametrize(
    ("method", "path", "needed"),
    [
        ("GET", "/", None),
        ("GET", "/web/app.js", None),
        ("GET", "/healthz", None),
        ("GET", "/api/v1/station", "read"),
        ("HEAD", "/api/v1/events", "read"),
        ("GET", "/metrics", "read"),
        ("GET", "/api/v1/keys", "admin"),
        ("GET", "/api/v1/audit", "admin"),
        ("GET", "/api/v1/calibration", "read"),
        ("GET", "/api/v1/calibration/trial", "admin"),
        ("GET", "/api/v1/settings", "admin"),
        ("GET", "/api/v1/optics/plan", "read"),
        ("POST", "/api/v1/unknown", "admin"),
        ("POST", "/api/v1/station/arm/", "admin"),
        ("GET", "/webx", "read"),
    ],
)
def test_an_address_needs_its_scope(method: str, path: str, needed: str | None) -> None:
    assert scope_needed(method, path) == needed


def test_a_login_ends_after_its_time_and_with_its_key(tmp_path: Path) -> None:
    keys, now = KeyFile(tmp_path / "keys.json"), [0.0]
    key = keys.create("operator", ["operate"]).key
    sessions = Sessions(lambda: now[0])
    token = sessions.begin(key)
    assert sessions.key_of(token, keys.entries()) == key
    assert sessions.key_of(token + "x", keys.entries()) is None
    now[0] = SESSION_S
    assert sessions.key_of(token, keys.entries()) is None
    token = sessions.begin(key)
    keys.rotate("operator")
    assert sessions.key_of(token, keys.entries()) is None
