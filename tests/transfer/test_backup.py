"""A backup, taken while the station runs, makes the same station on an empty machine."""

from __future__ import annotations

import os
import shutil
import sqlite3
import subprocess
import sys
from collections.abc import Iterator
from contextlib import closing
from pathlib import Path
from typing import IO, Any

import pytest

from tests.transfer.conftest import Site
from vaoi_station.config import read_config
from vaoi_station.demo.station_files import write_station_files
from vaoi_station.errors import DeviceError, GoneError, InputError
from vaoi_station.files import read_board_type, read_calibration
from vaoi_station.files.directories import files_below, remove_directory
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.run.reference_store import ReferenceStore
from vaoi_station.simulation import scenario_path
from vaoi_station.store import Database, Store
from vaoi_station.transfer import backup
from vaoi_station.transfer.backup import absent_files, back_up, check_database, copy_database, reading, restore
from vaoi_station.transfer.package import open_files, unpack_package, write_package


def test_everything_is_back_on_an_empty_machine(site: Site, tmp_path: Path) -> None:
    site.rig.coordinator.kept.pin(site.sound)
    site.rig.wait_for(lambda: site.rig.coordinator.kept.recordings.runs == 2, "the recording")
    (site.rig.config.data / "station.db.damaged-1").write_text("set aside")
    good = Path("good-boards", "small", f"{site.sound}.parts")
    (site.rig.config.data / good).parent.mkdir(parents=True)
    (site.rig.config.data / good).write_text("patches")
    expected = {run: site.rig.coordinator.stitch_text(run) for run in (site.sound, site.degraded)}
    events = len(site.rig.coordinator.events(0))
    site.rig.store.database.write(lambda _: None).result(10)  # all events are written
    summary = back_up(site.config, tmp_path / "backup")
    assert summary.size_bytes == (tmp_path / "backup").stat().st_size

    machine = tmp_path / "other machine"
    config = restore(tmp_path / "backup", machine / "station.toml")
    assert config == read_config(machine / "station.toml")
    # The first machine is lost: nothing of the second one may depend on it.
    for name in ("calibration.json", "board-types", "data", "station.toml"):
        path = tmp_path / name
        shutil.rmtree(path) if path.is_dir() else path.unlink()
    calibration = read_calibration(config.calibration, [c.head for c in config.cameras])
    board_type = read_board_type(config.board_types / "small.json")
    store = Store(Database(config.data / "station.db"))
    archive = Archive(store, EventLog(store))
    assert {run: archive.get(run).text for run in expected} == expected
    assert (config.data / good).read_text() == "patches"
    assert store.retention.pins() == {site.sound}
    assert len(store.events(0, 1000)) >= events
    shelf = ReferenceStore(config.data / "references", store, calibration.cameras(config.heads))
    reference = shelf.open(board_type)
    assert reference is not None
    assert reference.run == site.sound
    assert (config.data / "keys.json").read_text() == "{}"
    assert not (config.data / "recordings").exists()
    assert not list(config.data.glob("*damaged*"))
    assert list(machine.glob(".*")) == []
    store.close()


@pytest.mark.parametrize("place", ["flat fields", "data/flat fields"])
def test_flat_fields_are_back_too(site: Site, tmp_path: Path, place: str) -> None:
    (tmp_path / place).mkdir()
    (tmp_path / place / "flatfield.json").write_text("{}")
    site.config.write_text(f'flat_fields = "{place}"\n{site.config.read_text()}')
    back_up(site.config, tmp_path / "backup")
    config = restore(tmp_path / "backup", tmp_path / "other machine" / "station.toml")
    assert config.flat_fields == tmp_path / "other machine" / place
    assert [path.name for path in config.flat_fields.iterdir()] == ["flatfield.json"]


def test_recordings_are_included_on_request(site: Site, tmp_path: Path) -> None:
    picture = site.rig.config.data / "mosaics" / f"{site.degraded}_4.jpg"
    picture.parent.mkdir(exist_ok=True)
    picture.write_bytes(b"jpeg")
    back_up(site.config, tmp_path / "small")
    assert not (restore(tmp_path / "small", tmp_path / "a" / "station.toml").data / "mosaics").exists()
    back_up(site.config, tmp_path / "backup", recordings=True)
    config = restore(tmp_path / "backup", tmp_path / "b" / "station.toml")
    assert (config.data / "mosaics" / picture.name).is_file()
    assert (config.data / "recordings" / site.degraded / "recording.json").is_file()


def test_recordings_deleted_meanwhile_are_named_and_not_restored(site: Site, tmp_path: Path) -> None:
    recordings = site.rig.config.data / "recordings"
    shutil.copytree(recordings / site.degraded, recordings / "0-early")
    package, frames = tmp_path / "backup", 0

    def delete_one(*given: Any) -> Iterator[Any]:
        nonlocal frames
        for name, content in open_files(*given):
            yield name, content
            if given[0].name == "0-early" and name.startswith("frames/"):
                frames += 1
                remove_directory(recordings / "0-early")

    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(backup, "open_files", delete_one)
        summary = back_up(site.config, package, recordings=True)
    assert (summary.deleted, frames) == (("0-early",), 1)
    config = restore(package, tmp_path / "b" / "station.toml")
    assert [path.name for path in (config.data / "recordings").iterdir()] == [site.degraded]


def open_deleted(path: Path) -> Iterator[tuple[str, IO[bytes]]]:
    """Stand in for `open_files` while the station deletes the directory."""
    remove_directory(path)
    return open_files(path)


def test_a_reference_deleted_meanwhile_ends_the_backup(site: Site, tmp_path: Path) -> None:
    (reference,) = (site.rig.config.data / "references").iterdir()
    with pytest.MonkeyPatch.context() as patch:
        patch.setattr(backup, "open_files", open_deleted)
        with pytest.raises(GoneError, match=f"{reference.name}: was deleted while"):
            back_up(site.config, tmp_path / "backup")
    assert not (tmp_path / "backup").exists()


def test_only_the_service_reads_what_the_administrator_restores(
    site: Site, tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    (site.rig.config.data / "keys.json").write_text("{}")
    back_up(site.config, tmp_path / "backup")
    place = tmp_path / "b"
    (place / "board-types").mkdir(parents=True)
    given: dict[Path, tuple[int, int]] = {}
    monkeypatch.setattr(os, "geteuid", lambda: 0)
    monkeypatch.setattr(os, "chown", lambda path, uid, gid: given.update({Path(path): (uid, gid)}))
    data = restore(tmp_path / "backup", place / "station.toml").data
    assert data.stat().st_mode & 0o007 == 0
    assert (data / "station.db").stat().st_mode & 0o007 == 0
    assert (data / "keys.json").stat().st_mode & 0o777 == 0o600
    owner = place.stat()
    assert set(given.values()) == {(owner.st_uid, owner.st_gid)}, "the owner of the place"
    assert {"data", "keys.json", "small.json", "calibration.json"} <= {path.name for path in given}


def test_prepared_empty_folders_are_filled(site: Site, tmp_path: Path) -> None:
    back_up(site.config, tmp_path / "backup")
    (tmp_path / "b" / "data").mkdir(parents=True, mode=0o700)
    restore(tmp_path / "backup", tmp_path / "b" / "station.toml")
    assert (tmp_path / "b" / "data").stat().st_mode & 0o777 == 0o700
    assert (tmp_path / "b" / "data" / "station.db").is_file()


@pytest.mark.parametrize("present", ["station.toml", "calibration.json", "data/station.db", "board-types/x.json"])
def test_nothing_is_overwritten(site: Site, tmp_path: Path, present: str) -> None:
    back_up(site.config, tmp_path / "backup")
    path = tmp_path / "b" / present
    path.parent.mkdir(parents=True)
    path.write_text("mine")
    with pytest.raises(InputError, match="exists already"):
        restore(tmp_path / "backup", tmp_path / "b" / "station.toml")
    assert path.read_text() == "mine"
    assert [p for p in (tmp_path / "b").rglob("*") if p.is_file()] == [path]


def test_an_absolute_path_that_exists_is_named_as_the_reason(site: Site, tmp_path: Path) -> None:
    absolute = f'board_types = "{tmp_path / "board-types"}"'
    stated = site.config.read_text()
    site.config.write_text(stated.replace('board_types = "board-types"', absolute))
    back_up(site.config, tmp_path / "backup")
    with pytest.raises(InputError) as refused:
        restore(tmp_path / "backup", tmp_path / "b" / "station.toml")
    assert refused.value.message == (
        f"{tmp_path / 'board-types'}: exists already; nothing was restored. The station.toml of the backup states "
        f"this path as an absolute one, which is restored to where it says and not to {tmp_path / 'b'}."
    )
    assert "make the backup with relative paths" in refused.value.action
    assert list((tmp_path / "b").iterdir()) == []
    site.config.write_text(stated)
    back_up(site.config, tmp_path / "as advised")
    assert restore(tmp_path / "as advised", tmp_path / "b" / "station.toml").board_types == tmp_path / "b/board-types"


def test_a_damaged_backup_restores_nothing(site: Site, tmp_path: Path) -> None:
    back_up(site.config, tmp_path / "backup")
    content = bytearray((tmp_path / "backup").read_bytes())
    content[len(content) // 2] ^= 0xFF
    (tmp_path / "backup").write_bytes(content)
    with pytest.raises(InputError):
        restore(tmp_path / "backup", tmp_path / "b" / "station.toml")
    assert list((tmp_path / "b").iterdir()) == []


def test_names_in_a_backup_are_free(site: Site, tmp_path: Path) -> None:
    back_up(site.config, tmp_path / "backup")
    (tmp_path / "content").mkdir()
    manifest = unpack_package(tmp_path / "backup", backup.KIND, tmp_path / "content")
    # A restoration sets folders of the backup aside, in folders of its own.
    members = ((str(p.relative_to(tmp_path / "content")), p.read_bytes()) for p in files_below(tmp_path / "content"))
    added = [(f"{folder}/data/file", b"x") for folder in (".parts", "parts", "content")]
    about = {key: manifest[key] for key in ("station", "made", "software", "tables")}
    write_package(tmp_path / "crafted", backup.KIND, [*members, *added], about)
    config = restore(tmp_path / "crafted", tmp_path / "b" / "station.toml")
    assert (config.data / "station.db").is_file()


WRITER = """
import sqlite3, sys
c = sqlite3.connect(sys.argv[1], isolation_level=None, timeout=30)
c.execute("PRAGMA synchronous = OFF")
for n in range(1, 10**9):
    c.execute("BEGIN IMMEDIATE")
    c.execute("INSERT INTO events VALUES (?, ?)", (2 * n, "x" * 500))
    c.execute("INSERT INTO events VALUES (?, ?)", (2 * n + 1, "x" * 500))
    c.execute("COMMIT")
    if n == 200:
        print("on", flush=True)
"""


def test_a_copy_is_consistent_while_a_station_writes(tmp_path: Path) -> None:
    Database(tmp_path / "station.db").close()
    arguments = [sys.executable, "-c", WRITER, str(tmp_path / "station.db")]
    with subprocess.Popen(arguments, stdout=subprocess.PIPE) as writer:
        try:
            assert writer.stdout is not None
            assert writer.stdout.readline() == b"on\n"
            for number in range(3):
                copy = tmp_path / f"copy{number}.db"
                copy_database(tmp_path / "station.db", copy)
                check_database(copy)
                with closing(sqlite3.connect(copy)) as opened:
                    (rows,) = opened.execute("SELECT count(*) FROM events").fetchone()
                assert rows >= 400
                assert rows % 2 == 0, "the copy has half a transaction"
        finally:
            writer.kill()


def test_other_files_are_refused(tmp_path: Path) -> None:
    with pytest.raises(InputError, match="does not exist"), reading(tmp_path / "absent"):
        pass
    (tmp_path / "garbage").write_bytes(b"no database " * 1000)
    with pytest.raises(DeviceError, match="cannot be read"), reading(tmp_path / "garbage"):
        pass
    with closing(sqlite3.connect(tmp_path / "other")) as other:
        other.execute("PRAGMA user_version = 99")
    (tmp_path / "other").touch()
    with pytest.raises(InputError, match="version"), reading(tmp_path / "other"):
        pass


def test_a_damaged_copy_is_found(tmp_path: Path) -> None:
    path = tmp_path / "station.db"
    Database(path).close()
    content = bytearray(path.read_bytes())
    content[-4096:] = b"\xa5" * 4096
    path.write_bytes(content)
    with pytest.raises(DeviceError):
        check_database(path)


def test_every_table_and_list_is_searched(tmp_path: Path) -> None:
    path, _ = write_station_files(scenario_path("small"), tmp_path)
    config = read_config(path)
    (tmp_path / "station.pem").touch()
    with path.open("a") as file:
        file.write('\n[api]\ncertificate = "station.pem"\nprivate_key = "station.key"\n')
        file.write('\n[push.mqtt]\nhost = "broker"\nuser = "a"\npassword_file = "mqtt.password"\n')
    before = set(absent_files(config))
    assert set(absent_files(read_config(path))) - before == {
        ("api.private_key", tmp_path / "station.key"),
        ("push.mqtt.password_file", tmp_path / "mqtt.password"),
    }
