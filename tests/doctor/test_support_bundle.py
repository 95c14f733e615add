"""The bundle for support: complete, readable in any state, and without secrets."""

from __future__ import annotations

import json
import re
import tarfile
from pathlib import Path

import pytest

from tests.api.conftest import Served
from tests.api.held_station import HeldStation
from tests.peers.certificates import make_certificate
from vaoi_station.api.access import COOKIE, AccessControl
from vaoi_station.api.audit import AuditLog
from vaoi_station.doctor.support_bundle import REMOVED, without_secrets, write_support_bundle
from vaoi_station.errors import InputError
from vaoi_station.files.access_keys import AUDIT_FILE, KEY_FILE, KeyFile
from vaoi_station.files.caller_credentials import CallerCredentials
from vaoi_station.store import Database


def members(bundle: Path) -> dict[str, str]:
    with tarfile.open(bundle) as tar:
        files = {entry.name: tar.extractfile(entry) for entry in tar.getmembers()}
        return {name.split("/", 1)[1]: file.read().decode() for name, file in files.items() if file is not None}


def test_a_bundle_has_findings_files_and_database(station_toml: Path, tmp_path: Path) -> None:
    (tmp_path / "data").mkdir()
    Database(tmp_path / "data" / "station.db").close()
    out = tmp_path / "support.tar.gz"
    made = write_support_bundle(station_toml, out)
    assert made.members == sorted(members(out))
    found = members(out)
    assert json.loads(found["doctor.json"])["format"] == "vaoi-doctor"
    assert "no problem found" in found["check-config.txt"] or "warning" in found["check-config.txt"]
    assert "small.json" in found["files.txt"]
    assert "user_version" in found["database.txt"]
    assert found["running/station.json"].startswith("not available: ConnectionRefusedError")
    assert "none found" in found["README.txt"]
    # The station does not run, and not every machine has every command.
    assert made.missing["running/station.json"] in found["README.txt"]
    assert {"station.toml", "files.txt", "doctor.json"}.isdisjoint(made.missing)
    assert not [name for name in found if "board" in name], "layouts are not copied"


def test_secrets_are_nowhere_in_a_bundle(station_toml: Path, tmp_path: Path) -> None:
    text = station_toml.read_text()
    station_toml.write_text(
        text.replace("[api]", '[api]\nadmin_token = "hunter2-hunter2"\nproxy = "http://u:hunter2@h/"')
    )
    out = tmp_path / "support.tar.gz"
    write_support_bundle(station_toml, out)
    found = members(out)
    assert [name for name, content in found.items() if "hunter2" in content] == []
    assert "station.toml: 2" in found["README.txt"]


def test_no_key_no_hash_no_login_and_no_private_key_of_a_running_station_is_in_a_bundle(
    station_toml: Path, tmp_path: Path
) -> None:
    """A real service with TLS that asks for keys on loopback too; the bundle is made with the administrator's key."""
    data = tmp_path / "data"
    data.mkdir()
    keys, audit = KeyFile(data / KEY_FILE), AuditLog(data / AUDIT_FILE)
    admin, other = keys.create("admin", ["admin", "read"]), keys.create("tester-3", ["operate"])
    access = AccessControl(keys, audit, open_loopback=False)
    certificate = make_certificate(data)
    station = HeldStation()
    served = Served(station, access=access, certificate=certificate)
    served.client.get(f"/api/v1/runs/{other.secret}", headers={"authorization": f"Bearer {admin.secret}"})
    served.client.post(f"/api/v1/station/arm?board_type={other.secret}")
    login = served.client.post("/api/v1/session", json={"key": other.secret}).cookies[COOKIE]
    served.client.close()
    # Events and log lines may quote what a caller has sent by mistake.
    station.publish("trouble", f"called with {other.secret} and vaoi-session={login}")
    api = f'[api]\nport = {served.port}\ncertificate = "{certificate[0]}"\nprivate_key = "{certificate[1]}"\n'
    text = re.sub(r"(?m)^port = .*\n", "", station_toml.read_text())
    station_toml.write_text(text.replace("[api]\n", api))
    out = tmp_path / "support.tar.gz"
    write_support_bundle(station_toml, out, CallerCredentials(admin.secret))
    without_key = write_support_bundle(station_toml, tmp_path / "without-key.tar.gz")
    served.stop()
    audit.close()
    assert without_key.missing["running/station.json"].startswith("status 401: ")
    found = members(out)
    assert json.loads(found["running/station.json"])["state"] == "idle"
    assert REMOVED in found["running/events.txt"]
    private = certificate.private_key.read_text().splitlines()[1]
    secrets = [admin.secret, other.secret, admin.key.sha256, other.key.sha256, login, private]
    assert [(name, n) for name, content in found.items() for n, secret in enumerate(secrets) if secret in content] == []


@pytest.mark.parametrize(
    ("line", "kept"),
    [
        ('password = "a b"', "password = [removed]"),
        ("api_key: abc", "api_key: [removed]"),
        ('{"token": "abc", "x": 1}', '{"token": [removed], "x": 1}'),
        ("Authorization: Bearer abcdefghijkl", "Authorization: [removed]"),
        ("got bearer abcdefghijkl today", "got bearer [removed] today"),
        ("smb://user:pass@host/share", "smb://[removed]@host/share"),
        ("tokens = ['a', 'b']", "tokens = [removed]"),
        ("keyboard = 1; the key = value stays", "keyboard = 1; the key = value stays"),
        ("GET /x?key=vaoi_0123456789ab_A-b_c done", "GET /x?key=[removed] done"),
        ("VAOI_KEY=vaoi_0123456789ab_A-b_c", "VAOI_KEY=[removed]"),
        ('url = "https://chat.example/hooks/T0/B0/x9"', 'url = "https://chat.example[removed]"'),
        ('{"url": "https://a.example:8443?t=1", "n": 2}', '{"url": "https://a.example:8443[removed]", "n": 2}'),
        ('url = "http://127.0.0.1:9000"', 'url = "http://127.0.0.1:9000"'),
        ("POST https://a.example/in?sig=abc&n=2", "POST https://a.example/in?sig=[removed]&n=2"),
        ("sent vaoi-session=abc-def; path=/", "sent vaoi-session=[removed]; path=/"),
        ("-----BEGIN PRIVATE KEY-----\nabc\n-----END PRIVATE KEY-----", REMOVED),
    ],
)
def test_what_looks_like_a_secret_is_removed(line: str, kept: str) -> None:
    assert without_secrets(line) == kept


def test_a_station_that_cannot_be_read_still_has_a_bundle(tmp_path: Path) -> None:
    out = tmp_path / "support.tar.gz"
    made = write_support_bundle(tmp_path / "none.toml", out)
    found = members(out)
    assert {"station.toml", "files.txt"} <= made.missing.keys()
    assert "files.txt: not available: files, database and address" in found["README.txt"]
    assert found["station.toml"].startswith("not available: NotFoundError")
    assert "there is no such file" in found["check-config.txt"]
    assert "machine/meminfo.txt" in found
    with pytest.raises(InputError, match="exists already"):
        write_support_bundle(tmp_path / "none.toml", out)
