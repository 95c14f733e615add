"""station.toml as the page reads, checks and writes it."""

from __future__ import annotations

from pathlib import Path
from typing import Any

import pytest
from fastapi.testclient import TestClient

from tests.api.held_station import HeldStation
from vaoi_station.api.access import AccessControl
from vaoi_station.api.app import create_app
from vaoi_station.api.audit import AuditLog
from vaoi_station.api.setup.settings import SettingChange, SettingsFile
from vaoi_station.api.setup.station_files import StationFiles
from vaoi_station.config import read_config
from vaoi_station.errors import InputError, StateError
from vaoi_station.files.access_keys import KeyFile

SETTINGS = "/api/v1/settings"
BODY = {"changes": [{"key": "line.tail_s", "value": 0.5}]}
SECRET = """
[archive]
url = "sftp://user:T0-secret@store.example/runs"
"""


def _change(**values: Any) -> list[SettingChange]:
    return [SettingChange(key=key.replace("__", "."), value=value) for key, value in values.items()]


def _accept(_: bytes) -> None:
    """Stand for a caller that has read the present file."""


def test_a_change_is_written_with_a_copy_and_is_pending_until_a_restart(files: StationFiles) -> None:
    file = SettingsFile(files)
    before = files.path.read_text()
    assert file.read(file.content()).pending == []
    saved = file.save(_change(line__tail_s=1, cameras__1__gain_db=2), _accept)
    assert files.path.read_text() == before.replace("tail_s = 0.48", "tail_s = 1.0").replace(
        'name = "cam1"', 'name = "cam1"', 1
    ).replace(
        "nominal_center_mm = [36.0, 0.0]\nnominal_px_per_mm = 8.0\n",
        "nominal_center_mm = [36.0, 0.0]\nnominal_px_per_mm = 8.0\ngain_db = 2.0\n",
    )
    assert saved.backup is not None
    assert files.path.with_name(saved.backup).read_text() == before
    assert saved.changed == ["line.tail_s", "cameras.1.gain_db"]
    assert file.read(file.content()).pending == ["line.tail_s", "cameras.1.gain_db"]
    assert read_config(files.path).line.tail_s == 1.0


def test_all_faults_are_found_at_once_and_none_of_them_is_saved(files: StationFiles) -> None:
    file = SettingsFile(files)
    wrong = _change(workers=0, line__tail_s="long", cameras__2__name="cam1", line__typo=1, name__x=1)
    proposal = file.propose(wrong, file.content())
    # What cannot be edited prevents the edits; without it, every fault of the model is found.
    assert [f.key for f in proposal.faults] == ["name.x"]
    proposal = file.propose(wrong[:-1], file.content())
    assert {f.key for f in proposal.faults} == {"workers", "line.tail_s", "line.typo", ""}
    before = files.path.read_bytes()
    for changes in (wrong, wrong[:1]):
        with pytest.raises(InputError):
            file.save(changes, _accept)
    assert files.path.read_bytes() == before


def test_secrets_stay_in_the_file_and_are_never_shown(files: StationFiles) -> None:
    files.path.write_text(files.path.read_text() + SECRET)
    file = SettingsFile(files)
    read = file.read(file.content())
    assert read.hidden == ["archive.url"]
    proposal = file.propose(_change(name="talk"), file.content())
    assert proposal.hidden == 1
    assert "T0" not in read.model_dump_json() + proposal.model_dump_json()
    assert 'url = "sftp://…@store.example/runs"' in proposal.text
    shown = proposal.text.split('url = "')[1].split('"')[0]
    assert file.propose(_change(archive__url=shown), file.content()).faults[0].key == "archive.url"
    file.save(_change(name="talk"), _accept)
    assert "user:T0-secret@" in files.path.read_text()


def test_the_command_for_the_power_of_cameras_is_changed_only_in_the_file(files: StationFiles) -> None:
    file = SettingsFile(files)
    for change in (
        _change(camera_power__command=["/bin/sh", "-c", "id"]),
        _change(camera_power={"command": ["/bin/sh"]}),
    ):
        assert "names a command" in file.propose(change, file.content()).faults[0].message
        with pytest.raises(InputError, match="names a command that the station runs"):
            file.save(change, _accept)
    assert "camera_power" not in files.path.read_text()


def test_a_file_that_the_service_may_not_write_is_shown_checked_and_left(protected: StationFiles) -> None:
    file = SettingsFile(protected)
    read = file.read(file.content())
    assert not read.writable
    assert read.install.endswith(f" station.toml {protected.path}")
    assert read.restart.startswith(f"sudo vaoi check-config {protected.path} && ")
    proposal = file.propose(_change(workers=3), file.content())
    assert (proposal.faults, "+workers = 3" in proposal.diff) == ([], True)
    before = file.content()
    with pytest.raises(StateError) as refused:
        file.save(_change(workers=3), _accept)
    assert (refused.value.code, file.content()) == ("settings-read-only", before)


def test_a_file_with_faults_is_read_and_can_be_corrected(files: StationFiles) -> None:
    files.path.write_text(files.path.read_text().replace("tail_s = 0.48", 'tail_s = "x"\nodd = 1'))
    file = SettingsFile(files)
    read = file.read(file.content())
    assert ([f.key for f in read.faults], read.pending) == (["line.tail_s", "line.odd"], [])
    file.save(_change(line__tail_s=0.48, line__odd=None), _accept)
    assert file.read(file.content()).faults == []


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
