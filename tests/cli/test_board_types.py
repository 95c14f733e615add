"""`vaoi board-types` against a running station that asks for a key."""

from __future__ import annotations

import os
from collections.abc import Callable, Iterator
from pathlib import Path

import pytest

import vaoi_station as api
from tests.api.conftest import Served
from tests.api.held_station import HeldStation
from tests.api.routes.test_previews import import_here
from tests.board_data.readers import samples
from tests.cli.conftest import Result
from vaoi_station.api.access import AccessControl
from vaoi_station.api.audit import AuditLog
from vaoi_station.api.routes import board_data
from vaoi_station.errors import VaoiError
from vaoi_station.files.access_keys import KeyFile


@pytest.fixture
def closed(tmp_path: Path, monkeypatch: pytest.MonkeyPatch) -> Iterator[tuple[HeldStation, KeyFile]]:
    """A station whose address is in the environment, and its keys; loopback needs a key, too."""
    keys, audit = KeyFile(tmp_path / "keys.json"), AuditLog(tmp_path / "audit.jsonl")
    monkeypatch.setattr(board_data, "import_limited", import_here)
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
    secret = ("--key-file", tmp_path / "teach")
    done = vaoi("board-types", "state", "demo-board", "draft", "--revision", "B", *secret)
    assert done.out == "demo-board: draft, revision B.\n", done.err
    assert "demo-board: version latest" in vaoi("board-types", "restore", "demo-board", *secret).out
    assert vaoi("board-types", "state", "demo-board", "old", *secret).code == 2


def test_runs_are_taught_as_good_boards_and_taken_out_again(
    closed: tuple[HeldStation, KeyFile], vaoi: Callable[..., Result], tmp_path: Path
) -> None:
    station, keys = closed
    (tmp_path / "key").write_text(keys.create("teach", ["read", "teach"]).secret)
    first, second = station.film(), station.film()
    done = vaoi("teach", "--good", first, "--good", second, "--key-file", tmp_path / "key")
    assert done.out.splitlines() == [
        f"{first}: is kept as a good board of 'demo-board', which has 1.",
        f"{second}: is kept as a good board of 'demo-board', which has 2.",
    ], done.err
    done = vaoi("teach", "--not-good", first, "--key-file", tmp_path / "key")
    assert done.out == f"{first}: is no longer a good board of 'demo-board', which has 1.\n"
    done = vaoi("teach", "--not-good", first, "--key-file", tmp_path / "key")
    assert (done.code, "is not one of the good boards" in done.err) == (2, True)


def test_board_data_is_imported_shown_and_confirmed(
    closed: tuple[HeldStation, KeyFile], vaoi: Callable[..., Result], tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    station, keys = closed
    file, secret = tmp_path / "b.kicad_pcb", tmp_path / "key"
    file.write_text(samples.KICAD)
    secret.write_text(keys.create("t", ["read", "teach"]).secret)
    shown = vaoi("board-types", "import", file, "--name", "p", "--key-file", secret)
    assert shown.out.startswith("top of 'p' (kicad): 3 components, 1 fiducials, 0 test points\ncheck: "), shown.err
    assert "Nothing is stored yet" in shown.out
    assert "p" not in station.types
    stored = vaoi("board-types", "import", file, "--name", "p", "--confirm", "--key-file", secret)
    assert stored.out.endswith("p: stored; it can be armed.\n")
    assert len(station.types["p"].components) == 3
    again = ("board-types", "import", file, "--name", "p", "--side", "bottom", "--confirm", "--key-file", secret)
    assert "There is a board type 'p'; nothing was stored." in vaoi(*again).err
    sides = [station.types["p"].side]
    assert vaoi(*again, "--replace").code == 0
    assert [*sides, station.types["p"].side] == ["top", "bottom"]
    file.write_text("nonsense")
    assert "b.kicad_pcb: is no board of KiCad" in vaoi("board-types", "import", file, "--key-file", secret).err
    connected = api.connect(os.environ["VAOI_STATION"], key_file=secret)
    file.write_text(samples.KICAD)
    corrected = connected.upload_board_data(file, name="q").correct(side="bottom", name="q")
    assert corrected.picture.startswith(b"<svg")
    assert corrected.confirm(new=True).side == "bottom"
    _, tag = connected.board_types.get_tagged("q")
    assert connected.upload_board_data(file, name="q").confirm(tag=tag).side == "top"
    for conditions in ({"tag": tag}, {"new": True}):
        with pytest.raises(VaoiError, match="nothing was changed") as refusal:
            connected.upload_board_data(file, name="q").confirm(**conditions)
        assert refusal.value.code == "changed"
