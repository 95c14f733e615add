"""Routes for keys, the audit log and the login of the page."""

from __future__ import annotations

from collections.abc import Iterator
from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from vaoi_station.api.access import AccessControl
from vaoi_station.api.app import create_app
from vaoi_station.api.audit import AuditLog
from vaoi_station.files.access_keys import KeyFile

ORIGIN = {"origin": "https://testserver"}
ARM = "/api/v1/station/arm?board_type=demo-board"


@pytest.fixture
def keys(tmp_path: Path) -> KeyFile:
    return KeyFile(tmp_path / "keys.json")


@pytest.fixture
def outside(station: Any, keys: KeyFile, tmp_path: Path) -> Iterator[TestClient]:
    """A client at another machine, over TLS, that keeps cookies."""
    audit = AuditLog(tmp_path / "audit.jsonl")
    app = create_app(station, ["testserver"], AccessControl(keys, audit))
    with TestClient(app, base_url="https://testserver", client=("192.0.2.7", 5000)) as client:
        yield client
    audit.close()


def bearer(secret: str) -> dict[str, str]:
    return {"authorization": f"Bearer {secret}"}


def test_an_administrator_makes_rotates_and_revokes_keys(outside: Any, keys: KeyFile) -> None:
    admin = bearer(keys.create("chief", ["admin"]).secret)
    made = outside.post("/api/v1/keys", json={"name": "tester", "scopes": ["operate"]}, headers=admin)
    assert made.status_code == 201
    assert outside.get("/api/v1/station", headers=bearer(made.json()["secret"])).status_code == 200
    rotated = outside.post("/api/v1/keys/tester/rotate", headers=admin).json()
    assert outside.get("/api/v1/station", headers=bearer(made.json()["secret"])).status_code == 401
    assert outside.get("/api/v1/station", headers=bearer(rotated["secret"])).status_code == 200
    listed = outside.get("/api/v1/keys", headers=admin)
    assert [k["name"] for k in listed.json()["keys"]] == ["chief", "tester"]
    assert "secret" not in listed.text
    assert "sha256" not in listed.text
    assert outside.delete("/api/v1/keys/tester", headers=admin).status_code == 204
    assert outside.get("/api/v1/station", headers=bearer(rotated["secret"])).status_code == 401
    refused = outside.delete("/api/v1/keys/tester", headers=admin).json()
    assert (refused["code"], refused["action"]) == ("unknown-key", "See vaoi keys list.")
    entries = outside.get("/api/v1/audit?limit=50", headers=admin).json()["entries"]
    assert (entries[-1]["key"], entries[-1]["path"], entries[-1]["status"]) == ("chief", "/api/v1/keys", 201)


def test_a_page_logs_in_once_with_a_cookie_that_only_its_own_pages_send(outside: Any, keys: KeyFile) -> None:
    made = keys.create("operator", ["operate"])
    assert outside.get("/api/v1/session").json() == {"scopes": []}
    wrong = outside.post("/api/v1/session", json={"key": "vaoi_no"}, headers=ORIGIN)
    assert (wrong.status_code, wrong.json()["code"]) == (401, "no-key")
    login = outside.post("/api/v1/session", json={"key": made.secret}, headers=ORIGIN)
    cookie = login.headers["set-cookie"].lower()
    for attribute in ("httponly", "samesite=strict", "secure", "path=/"):
        assert attribute in cookie
    assert made.secret.lower() not in cookie
    assert outside.get("/api/v1/session").json() == {"key": "operator", "scopes": ["operate", "read"]}
    assert outside.post(ARM, headers=ORIGIN).status_code == 200
    assert outside.post(ARM, headers={"origin": "https://evil.example"}).status_code == 403
    assert outside.post(ARM).json()["code"] == "foreign-origin"
    chief = bearer(keys.create("chief", ["admin"]).secret)
    entries = outside.get("/api/v1/audit", headers=chief).json()["entries"]
    logins = [(e["key"], e["status"]) for e in reversed(entries) if e["path"] == "/api/v1/session"]
    assert logins == [("none", 401), ("operator", 200)]
    token = outside.cookies["vaoi-session"]
    assert outside.delete("/api/v1/session", headers=ORIGIN).status_code == 204
    outside.cookies.set("vaoi-session", token)
    assert outside.get("/api/v1/station").status_code == 401
