"""One run as one file: its record and result, the documents it was made with, and its frames if they were kept."""

from __future__ import annotations

import sqlite3
from collections.abc import Iterator
from itertools import chain
from pathlib import Path

from vaoi_station.config import read_config
from vaoi_station.errors import GoneError, NotFoundError, StateError
from vaoi_station.files.directories import new_directory, refuse_existing
from vaoi_station.files.documents import parse, read_json
from vaoi_station.runs.archive.recordings import DIRECTORY as RECORDINGS
from vaoi_station.runs.archive.recordings import RESULT_FILE, RUN_FILE
from vaoi_station.runs.archive.stored_documents import decided
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.schemas import RunDetail
from vaoi_station.store.schema import unpacked
from vaoi_station.transfer.backup import DATABASE
from vaoi_station.transfer.database_copy import reading
from vaoi_station.transfer.live_directories import open_files
from vaoi_station.transfer.package import Entry, unpack_package, write_package
from vaoi_station.version import __version__

KIND = "vaoi-run"
TIMELINE_FILE, HEIGHTS_FILE, IDENTITY_FILE, HEAD_FILE, CONFIGURATION_FILE, CALIBRATION_FILE, BOARD_FILE = (
    "timeline.json",
    "heights.json",
    "identity.json",
    "head.json",
    "configuration.json",
    "calibration.json",
    "board.json",
)


def export_run(config_path: Path, run: str, out: Path) -> bool:
    """Write a run to a file; return whether the file contains its frames.

    Raises:
        InputError: the file exists.
        NotFoundError: there is no such run.
        StateError: the run has not ended.
        GoneError: at most a summary of the run is kept, or the station deleted the frames meanwhile.
    """
    refuse_existing(out)
    config = read_config(config_path)
    recording = config.data / RECORDINGS / run
    with reading(config.data / DATABASE) as database:
        detail = _detail(database, run)
        recorded = (recording / "recording.json").is_file()
        documents = dict(_documents(database, detail))
        # The record of the database is the newer one: it has the state of the frames.
        frames = ((name, file) for name, file in open_files(recording) if name not in documents) if recorded else ()
        about = {"run": run, "station": config.name, "made": utc(), "software": __version__, "frames": recorded}
        write_package(out, KIND, chain[Entry](documents.items(), frames), about)
    return recorded


def import_run(package: Path, directory: Path) -> RunDetail:
    """Unpack an exported run into a new directory, and return its record.

    With frames, the directory is a recording, which `vaoi stitch`, `vaoi report` and `vaoi cut` accept.

    Raises:
        InputError: the directory exists, or the file is damaged.
    """
    with new_directory(directory) as draft:
        unpack_package(package, KIND, draft)
        return parse(RunDetail, read_json(draft / RUN_FILE), f"{package}: {RUN_FILE}")


def _detail(database: sqlite3.Connection, run: str) -> RunDetail:
    row = database.execute(
        "SELECT summary, detail, packed_detail, finish_number FROM runs WHERE id = ?", (run,)
    ).fetchone()
    if row is None:
        raise NotFoundError(f"There is no run {run!r}.", action="See the list of runs.", code="unknown-run")
    if row["finish_number"] is None:
        raise StateError(f"Run {run} has no result yet.", action="Export it when it has ended.")
    if not row["detail"]:
        raise GoneError(
            f"Result and record of run {run} were deleted because of their age, number or size.",
            action="Pin runs that are needed for long, or raise the limits of [keep].",
            code="run-forgotten",
        )
    return decided(unpacked(row["detail"], row["packed_detail"]), row["summary"])


def _documents(database: sqlite3.Connection, detail: RunDetail) -> Iterator[Entry]:
    yield RUN_FILE, detail.model_dump_json(indent=1).encode()
    for name, query in (
        (RESULT_FILE, "SELECT document, packed FROM results WHERE run = ?"),
        (HEIGHTS_FILE, "SELECT document, packed FROM heights WHERE run = ?"),
        (IDENTITY_FILE, "SELECT document, packed FROM identities WHERE run = ?"),
        (TIMELINE_FILE, "SELECT timeline, packed_timeline FROM runs WHERE id = ? AND timeline IS NOT NULL"),
        (HEAD_FILE, "SELECT head, NULL FROM runs WHERE id = ? AND head IS NOT NULL"),
        (
            CALIBRATION_FILE,
            "SELECT document, NULL FROM documents JOIN runs ON digest = calibration_digest WHERE id = ?",
        ),
        (BOARD_FILE, "SELECT document, NULL FROM documents JOIN runs ON digest = board_type_digest WHERE id = ?"),
    ):
        if (row := database.execute(query, (detail.id,)).fetchone()) is not None:
            yield name, unpacked(row[0], row[1]).encode()
    digest = detail.made_with.configuration if detail.made_with else ""
    if row := database.execute("SELECT document FROM configurations WHERE digest = ?", (digest,)).fetchone():
        yield CONFIGURATION_FILE, str(row[0]).encode()
