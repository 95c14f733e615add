"""Each address of the service has a scope."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest

from tests.api.held.setup_files import setup_files
from vaoi_station.api import create_app
from vaoi_station.api.access.access_control import AccessControl
from vaoi_station.api.access.audit import AuditLog
from vaoi_station.api.access.scopes import scope_needed
from vaoi_station.files.access_keys import KeyFile

EXPECTED = {
    "admin": {
        "POST /keys",
        "POST /settings/check",
        "PUT /settings",
        "POST /calibration/marks",
        "DELETE /calibration/trial",
        "POST /calibration/trial",
        "POST /calibration/trial/accept",
        "POST /keys/{name}/rotate",
        "DELETE /keys/{name}",
        "POST /station/set-aside/{file}/acknowledge",
    },
    "operate": {
        "POST /station/arm",
        "POST /station/disarm",
        "POST /runs/{run}/release",
        "PUT /runs/{run}/hold",
        "DELETE /runs/{run}/hold",
        "PUT /runs/{run}/pin",
        "DELETE /runs/{run}/pin",
        "PUT /runs/{run}/decision",
        "PUT /runs/{run}/identity/next-machine",
    },
    "teach": {
        "POST /cameras/{camera}/trial",
        "DELETE /cameras/{camera}/trial",
        "POST /board-types/{name}/correct",
        "POST /board-types/{name}/program/check",
        "POST /board-data/previews",
        "PUT /board-data/previews/{preview}",
        "DELETE /board-data/previews/{preview}",
        "POST /board-data/previews/{preview}/confirm",
        "PUT /board-types/{name}",
        "DELETE /board-types/{name}",
        "PUT /board-types/{name}/reference",
        "DELETE /board-types/{name}/reference",
        "POST /board-types/{name}/revisions/{revision}/restore",
        "PUT /board-types/{name}/method",
        "PUT /board-types/{name}/state",
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
