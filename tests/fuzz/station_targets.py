"""Targets for what a station finds beside it: replies of cameras, files and rows of an earlier start, packages."""

from __future__ import annotations

import json
import sqlite3
import tempfile
from collections.abc import Iterator
from contextlib import closing, contextmanager, suppress
from functools import cache
from pathlib import Path
from typing import Any

import numpy as np

from tests.fuzz.corpus import inputs
from tests.runs.conftest import a_board_type, a_calibration, a_config
from vaoi_station.acquisition.cameras.aravis import discovery, network
from vaoi_station.acquisition.ring import HEADER, PAGE_BYTES, Ring, read_owner, remove_leftovers
from vaoi_station.config import StationConfig, read_config
from vaoi_station.demo.station_files import to_toml
from vaoi_station.errors import VaoiError
from vaoi_station.files import write_board_type, write_calibration
from vaoi_station.push.publisher import read_state
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.archive.housekeeping import Retention
from vaoi_station.runs.archive.recordings import RUN_FILE
from vaoi_station.runs.control.calibration_watch import CalibrationWatch
from vaoi_station.runs.run.order import OrderFactory
from vaoi_station.runs.run.reference_store import ReferenceStore
from vaoi_station.runs.run.standing_order import StandingOrder
from vaoi_station.runs.states.run_ids import RunIds
from vaoi_station.store import BoardTypeDirectory, Database, Store
from vaoi_station.store.documents import digest_of
from vaoi_station.transfer.backup import KIND as BACKUP
from vaoi_station.transfer.backup import restore
from vaoi_station.transfer.package import write_package
from vaoi_station.transfer.runs import BOARD_FILE, CALIBRATION_FILE, import_into_history
from vaoi_station.transfer.runs import KIND as RUN

LARGEST_RING = 1 << 24
"""Size up to which the file of a ring is given the length that its header asks for."""


def gvcp_reply(data: bytes, folder: Path) -> None:
    """Read a datagram as replies of a camera: as it is, and with the header of a reply that is expected."""
    for datagram in (data, b"\0\0" + network.command(2, 1, data)[2:]):
        network.is_reply(datagram, 2, 1)
        discovery.discovered(datagram, 1)


def push_state(data: bytes, folder: Path) -> None:
    """Read what was published; nothing that a file may hold is refused."""
    path = folder / "state.json"
    path.write_bytes(data)
    assert 0 <= read_state(path, 5).last <= 5


def ring(data: bytes, folder: Path) -> None:
    """Open a file that another program has put in place of a ring, and all of its slots."""
    path = folder / "vaoi-other.ring"
    path.write_bytes(data)
    if len(data) >= PAGE_BYTES:
        # A file of a wrong length is refused before anything else is read.
        wanted = int(np.frombuffer(data[:PAGE_BYTES], dtype=HEADER)["file_bytes"][0])
        if len(data) < wanted < LARGEST_RING:
            with path.open("r+b") as file:
                file.truncate(wanted)
    read_owner(path)
    try:
        with closing(Ring.attach(path)) as opened:
            for slot in range(min(opened.layout.slots, 20)):
                opened.slot_record(slot)
                opened.frame(slot)
    finally:
        remove_leftovers(folder)


def backup(data: bytes, folder: Path) -> None:
    """Restore a backup: one with this station.toml, or with these members in place of its own.

    A database in form of a text stands for the one of the corpus; paths that lead out of the folder are left out.
    """
    members: dict[str, Any] = json.loads(inputs("backup")["members"])
    given = _object(data)
    members |= {"station.toml": data.decode("utf-8", "replace")} if given is None else given
    for name in ("station.toml", "data/station.db"):
        members.setdefault(name, "")
    source = folder / "source"
    source.mkdir()
    with suppress(VaoiError, TypeError, OSError, ValueError):
        (source / "station.toml").write_text(members["station.toml"])
        if not _inside(read_config(source / "station.toml"), source):
            return
    contents = {name: _content(document) for name, document in members.items()}
    if contents["data/station.db"] == b"database":
        contents["data/station.db"] = _database()
    package = folder / "backup.vaoi"
    with suppress(UnicodeEncodeError):  # a name that no member of a package can have
        write_package(package, BACKUP, contents.items(), {})
        restore(package, folder / "restored" / "station.toml")


def history(data: bytes, folder: Path) -> None:
    """Import a run that consists of these documents into a history; what was imported can be read and listed."""
    documents = _object(data)
    if documents is None:
        return
    # A wrong digest would hide everything behind it.
    for name, key in ((CALIBRATION_FILE, "calibration"), (BOARD_FILE, "board_type")):
        run = documents.get(RUN_FILE)
        if isinstance(run, dict) and name in documents:
            place = run if key == "calibration" else run.get("made_with")
            if isinstance(place, dict) and isinstance(place.get(key), str):
                place[key] = digest_of(json.dumps(documents[name]))
    config = _station(folder)
    package = folder / "run.vaoi"
    try:
        write_package(package, RUN, ((name, _content(d)) for name, d in documents.items()), {})
        imported = import_into_history(package, folder / "station.toml")
    except UnicodeEncodeError:  # a name that no member of a package can have
        return
    with _accepted(), _started(config) as archive:
        [summary] = archive.list(10, None)
        assert summary.id == imported.detail.id
        archive.get(summary.id)


def database(data: bytes, folder: Path) -> None:
    """Start on a database with these rows: {table: [row]}. A row that cannot be read must not end the start.

    Tables that triggers fill are as they fill them.
    """
    tables = _object(data)
    config = _station(folder)
    if tables is None:
        return
    with closing(sqlite3.connect(config.data / "station.db", isolation_level=None)) as connection:
        for table, rows in tables.items():
            for row in rows if isinstance(rows, list) and table != "whole_runs" else ():
                _insert(connection, table, row)
    with _accepted(), _started(config) as archive:
        summaries = archive.list(100, None)
        for summary in summaries:
            with suppress(VaoiError):  # a single run may be damaged
                archive.get(summary.id)


@contextmanager
def _accepted() -> Iterator[None]:
    """Make a refusal a find: what is in the database already cannot be refused any more."""
    try:
        yield
    except VaoiError as error:
        raise AssertionError(f"not accepted: {error.message}") from error


@contextmanager
def _started(config: StationConfig) -> Iterator[Archive]:
    """Build what reads the database at the start of a station, in its order."""
    with closing(Store(Database(config.data / "station.db"))) as store:
        events, calibration = EventLog(store), a_calibration()
        archive = Archive(store, events)
        watch = CalibrationWatch(store.checks, events, calibration, [c.name for c in config.cameras])
        watch.warnings()
        watch.status()
        cameras = calibration.cameras(config.heads)
        shelf = ReferenceStore(config.data / "references", store, cameras)
        shelf.sweep()
        retention = Retention(config.keep, store.retention)
        retention.sweep()
        retention.forget_unused()
        board_types = BoardTypeDirectory(config.board_types)
        StandingOrder(store.standing).resume(board_types.get, OrderFactory(config, calibration, store, shelf))
        RunIds(store.newest_run()).next()
        events.read(0, 0.0, 1000)
        yield archive


def _insert(connection: sqlite3.Connection, table: str, row: Any) -> None:
    """Insert a row, whose documents are trees here; what no table takes is left out."""
    if not isinstance(row, dict):
        return
    values = [json.dumps(v) if isinstance(v, dict | list) else v for v in row.values()]
    columns, places = ", ".join(f'"{name}"' for name in row), ", ".join("?" * len(row))
    with suppress(sqlite3.Error, UnicodeEncodeError, OverflowError):
        connection.execute(f'INSERT OR REPLACE INTO "{table}" ({columns}) VALUES ({places})', values)


def _station(folder: Path) -> StationConfig:
    """Write the files of a station that has filmed nothing yet; return its configuration."""
    config = a_config(folder)
    config.data.mkdir()
    (config.data / "station.db").write_bytes(_database())
    write_board_type(config.board_types / "small.json", a_board_type())
    write_calibration(config.calibration, a_calibration())
    # As a file allows it; boards of tests are kept for a shorter time.
    kept = config.model_copy(update={"ring": config.ring.model_copy(update={"keep_s": 1.0})})
    (folder / "station.toml").write_text(to_toml(kept))
    return config


@cache
def _database() -> bytes:
    """Return the file of an empty history."""
    with tempfile.TemporaryDirectory() as folder:
        path = Path(folder) / "station.db"
        Store(Database(path)).close()
        return path.read_bytes()


def _object(data: bytes) -> dict[str, Any] | None:
    with suppress(ValueError, RecursionError):
        document = json.loads(data)
        return document if isinstance(document, dict) else None
    return None


def _content(document: Any) -> bytes:
    """Return a member of a package: a text as it is, anything else as JSON."""
    text = document if isinstance(document, str) else json.dumps(document)
    return text.encode("utf-8", "replace")


def _inside(config: StationConfig, folder: Path) -> bool:
    paths = [config.calibration, config.board_types, config.data, config.flat_fields]
    if config.simulation is not None:
        paths.append(config.simulation.scenario)
    # The folder itself is refused, since it has content.
    return all(p is None or folder.resolve() in p.resolve().parents for p in paths)
