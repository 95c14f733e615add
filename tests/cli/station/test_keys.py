"""`vaoi keys` changes the keys of a station."""

from __future__ import annotations

import getpass
import json
from collections.abc import Callable
from pathlib import Path

from tests.cli.conftest import Result
from vaoi_station.config import read_config
from vaoi_station.demo.station_files import write_station_files
from vaoi_station.files.access_keys import AUDIT_FILE, KEY_FILE, KeyFile
from vaoi_station.simulation import scenario_path


def test_keys_are_made_listed_rotated_and_revoked(vaoi: Callable[..., Result], tmp_path: Path) -> None:
    path, _ = write_station_files(scenario_path("small"), tmp_path)
    keys = KeyFile(read_config(path).data / KEY_FILE)
    made = vaoi("keys", "create", "tester", "--scope", "operate", "--scope", "teach", "--config", path)
    found = keys.find(made.out.strip())
    assert found is not None
    assert found.scopes == ("operate", "teach")
    listed = vaoi("keys", "list", "--config", path)
    assert "tester" in listed.out
    assert made.out.strip() not in listed.out
    rotated = vaoi("keys", "rotate", "tester", "--config", path)
    assert keys.find(rotated.out.strip()) is not None
    revoked = vaoi("keys", "revoke", "tester", "--config", path)
    assert (revoked.code, revoked.out) == (0, "Key 'tester' is revoked.\n")
    assert keys.entries() == ()
    none = vaoi("keys", "list", "--config", path)
    assert (none.code, none.out) == (0, "")
    assert "There is no key" in none.err
    text = (keys.path.parent / AUDIT_FILE).read_text()
    entries = [json.loads(line) for line in text.splitlines()]
    assert [entry["path"] for entry in entries] == ["keys create tester", "keys rotate tester", "keys revoke tester"]
    assert entries[0].items() >= {"user": getpass.getuser(), "method": "vaoi", "query": "operate,teach"}.items()
    assert made.out.strip() not in text
    assert vaoi("keys", "revoke", "tester", "--config", path).code == 2
