"""`vaoi board-types` against a running station that asks for a key."""

from __future__ import annotations

from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

from tests.api.conftest import Served
from tests.api.held_station import HeldStation
from tests.cli.conftest import Result
from vaoi_station.api.access.access_control import AccessControl
from vaoi_station.api.access.audit import AuditLog
from vaoi_station.files.access_keys import KeyFile


@pytest.fixture
def closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[HeldStation, KeyFile]]:
    """A station whose address is in the environment, and its keys; loopback needs a key, too."""
    keys, audit = KeyFile(tmp_path / "keys.json"), AuditLog(tmp_path / "audit.jsonl")
    served = Served(HeldStation(), access=AccessControl(keys, audit, open_loopback=False))
    monkeypatch.setenv("VAOI_STATION", served.url)
    yield served.station, keys
    served.stop()
    audit.close()


def test_a_deleted_board_type_is_restored_with_a_key(
    closed: tuple[HeldStation, KeyFile], vaoi: Callable[..., Result], tmp_path: Path
) -> None:
    station, keys = closed
    before = station.types["demo-board"]
    station.delete_board_type("demo-board")
    refused = vaoi("board-types", "list")
    assert (refused.code, "needs a key" in refused.err) == (2, True)
    for scope in ("read", "teach"):
        (tmp_path / scope).write_text(keys.create(scope, [scope]).secret)
    key = ("--key-file", tmp_path / "read")
    assert vaoi("board-types", "list", *key).out.split() == ["demo-board", "deleted"]
    version = vaoi("board-types", "revisions", "demo-board", *key).out.split()[0]
    assert "needs the scope teach" in vaoi("board-types", "restore", "demo-board", version, *key).err
    done = vaoi("board-types", "restore", "demo-board", version, "--key-file", tmp_path / "teach")
    assert (done.code, done.out) == (0, f"demo-board: version {version} is in force, 3 components.\n")
    assert station.types["demo-board"] == before


def test_a_wrong_address_is_refused(vaoi: Callable[..., Result]) -> None:
    assert "must start with http" in vaoi("board-types", "list", "--station", "station-3").err
