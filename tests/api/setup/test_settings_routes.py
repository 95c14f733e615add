"""The settings over REST: scope, condition, audit log."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from tests.api.held_station import HeldStation
from vaoi_station.api import create_app
from vaoi_station.api.access.access_control import AccessControl
from vaoi_station.api.access.audit import AuditLog
from vaoi_station.api.setup.station_files import StationFiles
from vaoi_station.files.access_keys import KeyFile

SETTINGS = "/api/v1/settings"
BODY = {"changes": [{"key": "line.tail_s", "value": 0.5}]}


def test_a_change_needs_the_file_that_its_caller_has_read(client: Any, files: StationFiles) -> None:
    read = client.get(SETTINGS)
    assert next(key for key in read.json()["keys"] if key["key"] == "ring.runs")["maximum"] == 64
    without = client.put(SETTINGS, json=BODY)
    assert (without.status_code, "If-Match" in without.json()["detail"]) == (422, True)
    files.path.write_text(files.path.read_text() + "# another person\n")
    changed = client.put(SETTINGS, json=BODY, headers={"If-Match": read.headers["etag"]})
    assert (changed.status_code, changed.json()["code"]) == (412, "changed")
    assert "tail_s = 0.48" in files.path.read_text()
    new = client.get(SETTINGS).headers["etag"]
    saved = client.put(SETTINGS, json=BODY, headers={"If-Match": new})
    assert (saved.status_code, saved.json()["changed"]) == (200, ["line.tail_s"])
    assert "# another person" in files.path.read_text()
    wrong = client.put(SETTINGS, json={"changes": [{"key": "workers", "value": 0}]}, headers={"If-Match": "*"})
    assert (wrong.status_code, "workers" in wrong.json()["detail"]) == (422, True)


def test_the_check_changes_nothing(client: Any, files: StationFiles) -> None:
    before = files.path.read_bytes()
    answer = client.post(f"{SETTINGS}/check", json=BODY).json()
    assert (answer["faults"], "+tail_s = 0.5" in answer["diff"], files.path.read_bytes()) == ([], True, before)
    for value in ('"\\ud800"', "[[[]]]", '{"a": {}}', "1e999", "NaN", "true", "[" * 600 + "]" * 600):
        body = f'{{"changes": [{{"key": "line.tail_s", "value": {value}}}]}}'
        odd = client.post(f"{SETTINGS}/check", content=body, headers={"Content-Type": "application/json"})
        assert (odd.status_code, [f["key"].split(".")[0] for f in odd.json()["faults"]]) == (200, ["line"]), value


def test_the_audit_log_names_what_was_changed_and_no_values(
    station: HeldStation, files: StationFiles, tmp_path: Path
) -> None:
    audit = AuditLog(tmp_path / "audit.jsonl")
    keys = KeyFile(tmp_path / "keys.json")
    app = create_app(station, ["testserver"], AccessControl(keys, audit), files=files)
    secrets = {scope: keys.create(scope, [scope]).secret for scope in ("admin", "teach")}
    with TestClient(app) as client:
        headers = {scope: {"Authorization": f"Bearer {secret}"} for scope, secret in secrets.items()}
        assert client.get(SETTINGS, headers=headers["teach"]).status_code == 403
        assert client.post(f"{SETTINGS}/check", json=BODY, headers=headers["teach"]).status_code == 403
        assert client.post(f"{SETTINGS}/check", json=BODY, headers=headers["admin"]).status_code == 200
        assert client.put(SETTINGS, json=BODY, headers={**headers["admin"], "If-Match": "*"}).status_code == 200
        entries = client.get("/api/v1/audit", headers=headers["admin"]).json()["entries"]
    audit.close()
    assert [(e["key"], e["method"], e["status"], e.get("changed")) for e in entries] == [
        ("admin", "PUT", 200, ["line.tail_s"]),
        ("teach", "POST", 403, None),
        ("teach", "GET", 403, None),
    ]


@pytest.mark.parametrize("content", ["a =", "\0"])
def test_a_file_that_is_no_toml_is_a_refusal(client: Any, files: StationFiles, content: str) -> None:
    files.path.write_text(content)
    assert client.get(SETTINGS).status_code == 422
    assert client.post(f"{SETTINGS}/check", json=BODY).status_code == 422
