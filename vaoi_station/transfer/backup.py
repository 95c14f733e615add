"""Backup of a station in one file, and its restoration to a place where there is no station."""

from __future__ import annotations

import filecmp
import os
import shutil
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from dataclasses import dataclass
from pathlib import Path

from pydantic import BaseModel

from vaoi_station.config import StationConfig, read_config
from vaoi_station.errors import DeviceError, GoneError, InputError
from vaoi_station.files.access_keys import KEY_FILE
from vaoi_station.files.directories import files_below, refuse_existing
from vaoi_station.runs.archive.recordings import DIRECTORY as RECORDINGS
from vaoi_station.runs.archive.recordings import HEAD_FILE
from vaoi_station.runs.mosaics.kept_mosaics import DIRECTORY as MOSAICS
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.store.database_file import MARK
from vaoi_station.store.schema import VERSION
from vaoi_station.transfer.package import Entry, open_files, unpack_package, write_package
from vaoi_station.version import __version__

KIND = "vaoi-backup"
CONFIG, CALIBRATION, BOARD_TYPES, SCENARIO, DATA = "station.toml", "calibration.json", "board-types", "scenario", "data"
FLAT_FIELDS = "flat-fields"
DATABASE, REFERENCES = "station.db", "references"
_ELSEWHERE = "Restore to a machine or a folder without a station, or move the old one away."


@dataclass(frozen=True)
class BackupSummary:
    """The content of a backup."""

    files: int
    size_bytes: int
    deleted: tuple[str, ...]
    """Runs whose recordings the station deleted while the backup was made, so that it does not have them."""


def back_up(config_path: Path, out: Path, *, recordings: bool = False) -> BackupSummary:
    """Write configuration, calibration, flat fields, board types, references and history of a station to a file.

    The station may run. `recordings` includes the kept recordings of frames, and the pictures of boards.

    Raises:
        InputError: the file `out` exists.
        GoneError: a reference was deleted while the backup was made, which has a database that names it.
    """
    refuse_existing(out)
    config = read_config(config_path)
    out.parent.mkdir(parents=True, exist_ok=True)
    # The copy of the database is made beside the backup, because that disk must have room for it in any case.
    with tempfile.TemporaryDirectory(dir=out.parent, prefix=f".{out.name}.") as scratch:
        database = Path(scratch) / DATABASE
        copy_database(config.data / DATABASE, database)
        about = {"station": config.name, "made": utc(), "software": __version__, "tables": VERSION}
        deleted: list[str] = []
        entries = _entries(config_path, config, database, deleted if recordings else None)
        files = write_package(out, KIND, entries, about)
    return BackupSummary(files, out.stat().st_size, tuple(deleted))


def restore(package: Path, config_path: Path) -> StationConfig:
    """Restore a backup: write station.toml to `config_path`, and all other files to the paths that it names.

    Nothing is written before the backup was unpacked and checked completely.

    Raises:
        InputError: the backup is damaged, or something exists where it would be written.
    """
    refuse_existing(config_path, action=_ELSEWHERE)
    config_path.parent.mkdir(parents=True, exist_ok=True)
    with tempfile.TemporaryDirectory(dir=config_path.parent, prefix=".restore.") as scratch:
        # The names in a package are free, so its content has a folder of its own.
        unpacked, parts = Path(scratch) / "content", Path(scratch) / "parts"
        unpacked.mkdir()
        parts.mkdir()
        unpack_package(package, KIND, unpacked)
        check_database(unpacked / DATA / DATABASE)
        _drop_deleted(unpacked / DATA / RECORDINGS)
        # Paths in the file are relative to its folder, so it is read as if it were there already.
        config = read_config(unpacked / CONFIG)
        # A file that exists already, such as a scenario of the package, is no problem.
        base = config_path.resolve().parent
        moves = [
            (source, target)
            for source, target in _moves(unpacked, parts, config, base)
            if not (source.is_file() and target.is_file() and filecmp.cmp(source, target, shallow=False))
        ]
        _make_private(parts / DATA)
        for _, target in moves:
            _refuse_content(target, base)
        for source, target in moves:
            _move(source, target)
        # This is moved last, because a folder with a station.toml counts as a complete station.
        shutil.move(unpacked / CONFIG, config_path)
    return read_config(config_path)


def _entries(config_path: Path, config: StationConfig, database: Path, deleted: list[str] | None) -> Iterator[Entry]:
    """Yield everything of a backup.

    Without recordings and pictures of boards if `deleted`, to which it adds recordings that were deleted, is None.
    """
    yield from _file(config_path, CONFIG)
    yield from _file(database, f"{DATA}/{DATABASE}")
    yield from _file(config.calibration, CALIBRATION)
    if config.simulation is not None:
        yield from _file(config.simulation.scenario, SCENARIO)
    yield from _files(config.board_types, BOARD_TYPES)
    if config.flat_fields is not None and not config.flat_fields.is_relative_to(config.data):
        yield from _files(config.flat_fields, FLAT_FIELDS)
    for path in _visible(config.data):
        name = f"{DATA}/{path.name}"
        # The files beside the database belong to it, or are damaged ones that were set aside. Only its marker file is
        # kept.
        if path.name.startswith(DATABASE) and not path.name.endswith(MARK):
            continue
        if path.name == RECORDINGS and deleted is not None:
            yield from _recordings(path, name, deleted)
        elif path.name == REFERENCES:
            for below in _visible(path):
                yield from _whole(below, f"{name}/{below.name}")
        elif path.name not in (RECORDINGS, MOSAICS) or deleted is not None:
            yield from _files(path, name)


def _recordings(directory: Path, name: str, deleted: list[str]) -> Iterator[Entry]:
    """Yield the files of all recordings. One that the station deletes meanwhile for want of space is no error."""
    for recording in _visible(directory):
        try:
            yield from _whole(recording, f"{name}/{recording.name}")
        except GoneError:
            deleted.append(recording.name)


def _whole(path: Path, name: str) -> Iterator[Entry]:
    """Yield a file, or all files of a recording or reference; GoneError if it is deleted meanwhile."""
    if path.is_file():
        yield from _file(path, name)
    else:
        yield from ((f"{name}/{below}", content) for below, content in open_files(path))


def _visible(directory: Path) -> list[Path]:
    """Return what is in a directory, without unfinished work."""
    return sorted(path for path in directory.iterdir() if not path.name.startswith("."))


def _files(path: Path, name: str) -> Iterator[Entry]:
    """Yield a file, or all files below a folder, except temporary ones and those that are deleted meanwhile."""
    if path.is_dir():
        for file in files_below(path, hidden=False):
            yield from _file(file, f"{name}/{file.relative_to(path).as_posix()}")
    else:
        yield from _file(path, name)


def _file(path: Path, name: str) -> Iterator[Entry]:
    """Yield a regular file, unless it is absent."""
    if path.is_file():
        with suppress(FileNotFoundError), path.open("rb") as content:
            yield name, content


def _drop_deleted(recordings: Path) -> None:
    """Remove what the backup has of recordings that the station deleted meanwhile; `open_files` says how they look."""
    for recording in _visible(recordings) if recordings.is_dir() else ():
        if not (recording / HEAD_FILE).is_file():
            shutil.rmtree(recording)


def _moves(unpacked: Path, parts: Path, config: StationConfig, base: Path) -> list[tuple[Path, Path]]:
    """Return all moves as (source, target).

    Paths of station.toml below the draft's folder are below `base` in the end.
    """

    def final(path: Path) -> Path:
        inside = path.is_relative_to(unpacked.resolve())
        return base / path.relative_to(unpacked.resolve()) if inside else path

    targets = {CALIBRATION: config.calibration, BOARD_TYPES: config.board_types, DATA: config.data}
    if config.simulation is not None:
        targets[SCENARIO] = config.simulation.scenario
    if config.flat_fields is not None:
        targets[FLAT_FIELDS] = config.flat_fields
    # They are set aside first, because the draft has the folders of the package, not those of the file.
    present = {name: target for name, target in targets.items() if (unpacked / name).exists()}
    return [((unpacked / name).rename(parts / name), final(target)) for name, target in present.items()]


def _move(source: Path, target: Path) -> None:
    """Move a file or folder.

    If the target is an empty folder, it keeps its owner and mode, and receives the content. The administrator, who may
    write everywhere, gives it to the owner of the place: the service must be able to use its data.
    """
    target.parent.mkdir(parents=True, exist_ok=True)
    if os.geteuid() == 0:
        owner = (target if target.is_dir() else target.parent).stat()
        for path in (source, *source.rglob("*")):
            os.chown(path, owner.st_uid, owner.st_gid)
    for part in source.iterdir() if target.is_dir() else ():
        shutil.move(part, target / part.name)
    if not target.exists():
        shutil.move(source, target)


def _make_private(data: Path) -> None:
    """Let only the owner and group of the data read them, and only the owner the secrets, as the service does."""
    for path in (data, *data.rglob("*")):
        path.chmod(path.stat().st_mode & 0o770)
    if (data / KEY_FILE).is_file():
        (data / KEY_FILE).chmod(0o600)


def _refuse_content(target: Path, base: Path) -> None:
    """Raise InputError for a target that exists, unless it is an empty folder; `base` is the folder of station.toml."""
    if not target.exists() or (target.is_dir() and not any(target.iterdir())):
        return
    if target.is_relative_to(base):
        raise InputError(f"{target}: exists already; nothing was restored.", action=_ELSEWHERE)
    raise InputError(
        f"{target}: exists already; nothing was restored. The station.toml of the backup states this path as an "
        f"absolute one, which is restored to where it says and not to {base}.",
        action="Move what is there away, restore to another machine, or make the backup with relative paths in "
        "station.toml.",
    )


BUSY_S = 30.0


@contextmanager
def reading(path: Path) -> Iterator[sqlite3.Connection]:
    """Open a database for reading; a running station is not disturbed.

    Raises:
        InputError: there is no database, or one of another version of the tables.
        DeviceError: the file cannot be read.
    """
    if not path.is_file():
        raise InputError(f"{path}: does not exist.", action="Give the station.toml of a station that has been started.")
    try:
        with closing(sqlite3.connect(f"{path.resolve().as_uri()}?mode=ro", uri=True, timeout=BUSY_S)) as connection:
            connection.row_factory = sqlite3.Row
            (found,) = connection.execute("PRAGMA user_version").fetchone()
            if found != VERSION:
                raise InputError(
                    f"{path}: has version {found} of the tables, but this software has version {VERSION}.",
                    action="Use the software of the station; a newer one migrates the file when it starts.",
                )
            yield connection
    except sqlite3.DatabaseError as error:
        raise DeviceError(
            f"{path}: cannot be read ({error}).", action="Check space, permissions and the state of the disk."
        ) from error


def copy_database(path: Path, target: Path) -> None:
    """Copy a database in one consistent state, also while a station writes to it."""
    with reading(path) as connection:
        # One read transaction: the station's writes go to the write-ahead log meanwhile. The copy has no free pages.
        connection.execute("VACUUM INTO ?", (str(target),))


def check_database(path: Path) -> None:
    """Raise DeviceError if a database is damaged, InputError if it has another version of the tables."""
    with reading(path) as connection:
        fault = connection.execute("PRAGMA quick_check(1)").fetchone()[0]
        if fault != "ok":
            raise DeviceError(f"{path}: is not a sound database ({fault}).", code="database-damaged")


def absent_files(section: BaseModel, place: str = "") -> Iterator[tuple[str, Path]]:
    """Yield key and path of every file or directory that a configuration names and that does not exist."""
    for key in type(section).model_fields:
        value = getattr(section, key)
        for part in value if isinstance(value, tuple) else (value,):
            if isinstance(part, Path) and not part.exists():
                yield f"{place}{key}", part
            elif isinstance(part, BaseModel):
                yield from absent_files(part, f"{place}{key}.")
