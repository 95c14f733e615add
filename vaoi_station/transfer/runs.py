"""One run as one file: exported, unpacked into a directory, or put into the history of a station."""

from __future__ import annotations

import json
import os
import re
import shutil
import sqlite3
import tempfile
import time
from collections.abc import Iterator
from contextlib import closing, contextmanager
from dataclasses import dataclass
from itertools import chain
from pathlib import Path
from typing import Any, TypeVar

from pydantic import BaseModel

from vaoi_station.config import KeepConfig, read_config
from vaoi_station.errors import DeviceError, GoneError, InputError, NotFoundError, StateError
from vaoi_station.files.directories import (
    make_directories,
    new_directory,
    refuse_existing,
    remove_directory,
    size_below,
)
from vaoi_station.files.documents import parse, read_json, read_text, write_bytes
from vaoi_station.files.recordings import open_recording
from vaoi_station.model import BoardType, Calibration, RecordingHead, Status, Stitch
from vaoi_station.model.board_identity import IdentityDocument
from vaoi_station.model.board_type import STORED_NAME
from vaoi_station.parts.learned import ENDING, read_taught_board
from vaoi_station.runs.archive.measured_parts import DIRECTORY as GOOD_BOARDS
from vaoi_station.runs.archive.measured_parts import good_file
from vaoi_station.runs.archive.recordings import DIRECTORY as RECORDINGS
from vaoi_station.runs.archive.recordings import DISK_RESERVE, RESULT_FILE, RUN_FILE
from vaoi_station.runs.archive.recordings import HEAD_FILE as RECORDING_FILE
from vaoi_station.runs.archive.stored_documents import decided, identity_row, in_state
from vaoi_station.runs.run.run_views import summary_of
from vaoi_station.runs.run.verdict import RunVerdict, identified
from vaoi_station.runs.states.run_ids import assigned_s, is_run_id, utc
from vaoi_station.runs.states.schemas import HeightList, Origin, PartsDocument, RunDetail, Timeline
from vaoi_station.runs.states.tables import RunState
from vaoi_station.runs.workers.parts_jobs import MOST_GOOD
from vaoi_station.store.documents import digest_of, write_identity
from vaoi_station.store.retention import MOST_PINS
from vaoi_station.store.schema import packed, unpacked
from vaoi_station.transfer.backup import BUSY_S, DATABASE, reading
from vaoi_station.transfer.package import Entry, open_files, unpack_package, write_package
from vaoi_station.version import __version__

KIND = "vaoi-run"
TIMELINE_FILE, HEIGHTS_FILE, IDENTITY_FILE, HEAD_FILE = "timeline.json", "heights.json", "identity.json", "head.json"
PARTS_FILE, GOOD_FILE = "parts.json", f"good{ENDING}"
CONFIGURATION_FILE, CALIBRATION_FILE, BOARD_FILE = "configuration.json", "calibration.json", "board.json"


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
        if (good := good_file(config.data / GOOD_BOARDS, detail.board_type, run)).is_file():
            documents[GOOD_FILE] = good.read_bytes()
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


_OF_DIGEST = "SELECT document, NULL FROM documents JOIN runs ON digest = {} WHERE id = ?"


def _documents(database: sqlite3.Connection, detail: RunDetail) -> Iterator[Entry]:
    yield RUN_FILE, detail.model_dump_json(indent=1).encode()
    for name, query in (
        (RESULT_FILE, "SELECT document, packed FROM results WHERE run = ?"),
        (HEIGHTS_FILE, "SELECT document, packed FROM heights WHERE run = ?"),
        (PARTS_FILE, "SELECT document, packed FROM parts WHERE run = ?"),
        (IDENTITY_FILE, "SELECT document, packed FROM identities WHERE run = ?"),
        (TIMELINE_FILE, "SELECT timeline, packed_timeline FROM runs WHERE id = ? AND timeline IS NOT NULL"),
        (HEAD_FILE, "SELECT head, NULL FROM runs WHERE id = ? AND head IS NOT NULL"),
        (CALIBRATION_FILE, _OF_DIGEST.format("calibration_digest")),
        (BOARD_FILE, _OF_DIGEST.format("board_type_digest")),
    ):
        if (row := database.execute(query, (detail.id,)).fetchone()) is not None:
            yield name, unpacked(row[0], row[1]).encode()
    digest = detail.made_with.configuration if detail.made_with else ""
    if row := database.execute("SELECT document FROM configurations WHERE digest = ?", (digest,)).fetchone():
        yield CONFIGURATION_FILE, str(row[0]).encode()


_AHEAD_S = 60.0
"""Time by which a run may be newer than this machine's clock says. Ids of later boards must sort after it."""
_AGAIN = "Export the run again."
M = TypeVar("M", bound=BaseModel)


@dataclass(frozen=True)
class ImportedRun:
    """A run that was put into a history; whether it has its frames as a recording, and is a good board."""

    detail: RunDetail
    with_frames: bool
    good: bool


@dataclass(frozen=True)
class _Content:
    """The checked content of an exported run, as texts that are stored."""

    detail: RunDetail
    calibration: str
    board_type: str
    head: str
    result: str | None
    timeline: str | None
    heights: str | None
    parts: str | None
    identity: IdentityDocument | None
    configuration: str | None
    good: bytes | None
    """What is kept of a good board."""
    frames_bytes: int
    """Size of the recording; 0 if the package has no frames."""


def import_into_history(package: Path, config_path: Path) -> ImportedRun:
    """Put an exported run into the history of a station, pinned and with its origin marked.

    The run is not announced: `runs/next` and `runs/latest` never return it. Its frames, if the package has them, become
    a recording of the station. A good board is one of the station's, too, if its type does not have too many.

    Raises:
        InputError: the package is damaged or of another kind, the history has the run already, or no station was
            started there.
        DeviceError: the disk has no room for the frames, or refuses the run.
    """
    config = read_config(config_path)
    database, recordings = config.data / DATABASE, config.data / RECORDINGS
    with reading(database):
        _refuse_other_user(database)
    with tempfile.TemporaryDirectory(dir=config.data, prefix=".import.") as scratch:
        folder = Path(scratch)
        manifest = unpack_package(package, KIND, folder, spare_bytes=DISK_RESERVE)
        content = _Unpacked(package, folder).content(manifest)
        (folder / GOOD_FILE).unlink(missing_ok=True)
        good = good_file(config.data / GOOD_BOARDS, content.detail.board_type, content.detail.id)
        is_good = content.good is not None and len([*good.parent.glob(f"*{ENDING}")]) < MOST_GOOD
        target = recordings / content.detail.id
        with_frames = content.frames_bytes > 0 and not target.exists()
        if with_frames:
            _refuse_without_room(config.keep, config.data, content.frames_bytes)
        with _writing(database) as connection:
            _insert(connection, content)
            if with_frames:
                with new_directory(target) as draft:
                    for path in sorted(folder.iterdir()):
                        shutil.move(path, draft / path.name)
            try:
                connection.execute("COMMIT")
            except BaseException:  # the run is not in the history, whatever the reason: raise it again
                if with_frames:
                    remove_directory(target)
                raise
        if content.good is not None and is_good:
            make_directories(good.parent)
            write_bytes(good, content.good)
    return ImportedRun(content.detail, target.exists(), is_good)


@dataclass(frozen=True)
class _Unpacked:
    """An unpacked run; an InputError, which names the package and its file, says what is absent or wrong."""

    package: Path
    folder: Path

    def content(self, manifest: dict[str, Any]) -> _Content:
        detail = self._document(RunDetail, RUN_FILE)
        if not is_run_id(detail.id):
            raise InputError.field(f"{self.package}: {RUN_FILE}", "id", detail.id, "a run id, as 01m7ykwxtb-52y1hr")
        if (assigned := assigned_s(detail.id)) > time.time() + _AHEAD_S:
            time_of_run = time.strftime("%Y-%m-%dT%H:%M:%SZ", time.gmtime(assigned))
            raise InputError(
                f"{self.package}: run {detail.id} is of {time_of_run}, which is later than this machine's "
                f"clock ({utc()}).",
                action="Set the clock of this machine (timedatectl); ids of later runs must sort after this one.",
            )
        calibration, board_type = self._text(CALIBRATION_FILE), self._text(BOARD_FILE)
        known, head = self._document(Calibration, CALIBRATION_FILE), self._document(RecordingHead, HEAD_FILE)
        of_type = self._document(BoardType, BOARD_FILE)
        self._refuse_other_digest(CALIBRATION_FILE, calibration, detail.calibration)
        if detail.made_with is not None:
            self._refuse_other_digest(BOARD_FILE, board_type, detail.made_with.board_type)
        if len(head.cameras) != len(known.camera_matrices):
            raise InputError(
                f"{self.package}: its recording has {len(head.cameras)} cameras, but its {CALIBRATION_FILE} has "
                f"{len(known.camera_matrices)}.",
                action=_AGAIN,
            )
        size = 0
        if (self.folder / RECORDING_FILE).is_file():
            self._check_frames()
            size = size_below(self.folder)
        # Of a run that was exported while its codes were read, no one will read them here.
        identity = (
            self._document(IdentityDocument, IDENTITY_FILE).without_reading() if self._has(IDENTITY_FILE) else None
        )
        heights = self._document(HeightList, HEIGHTS_FILE) if self._has(HEIGHTS_FILE) else None
        parts = self._document(PartsDocument, PARTS_FILE) if self._has(PARTS_FILE) else None
        for model, name in ((Stitch, RESULT_FILE), (Timeline, TIMELINE_FILE)):
            if self._has(name):
                self._document(model, name)
        result, timeline, configuration = (
            self._text(name) if self._has(name) else None for name in (RESULT_FILE, TIMELINE_FILE, CONFIGURATION_FILE)
        )
        marked = self._marked(detail, manifest, identity)
        self._stored(marked, RUN_FILE)
        return _Content(
            marked,
            calibration,
            board_type,
            self._stored(head, HEAD_FILE),
            result,
            timeline,
            None if heights is None else self._stored(heights, HEIGHTS_FILE, exclude_none=True),
            None if parts is None else self._stored(parts, PARTS_FILE, exclude_none=True),
            identity,
            configuration,
            self._good(detail, of_type) if self._has(GOOD_FILE) else None,
            size,
        )

    def _marked(self, detail: RunDetail, manifest: dict[str, Any], identity: IdentityDocument | None) -> RunDetail:
        """Return the record as this station keeps it, with the verdict that the identity leaves."""
        station, made = (str(manifest.get(key, "")) for key in ("station", "made"))
        origin = Origin(station=station, exported=made, imported=utc())
        changed = {"origin": origin, "stored": True, "pinned": False, "recording": False}
        marked = in_state(detail, RunState.GONE).model_copy(update=changed)
        return identified(marked, RunVerdict(marked.verdict, marked.reasons), identity)

    def _good(self, detail: RunDetail, board_type: BoardType) -> bytes:
        """Return what is kept of a good board; it is one of later comparisons, and must be of this run and type."""
        path = self.folder / GOOD_FILE
        try:
            board = read_taught_board(path)
        except InputError as error:
            named = error.message.replace(str(path), f"{self.package}: {GOOD_FILE}")
            raise InputError(named, action=_AGAIN) from error
        if (
            (board.name, board_type.name) != (detail.id, detail.board_type)
            or not board.is_of(board_type)
            or not re.fullmatch(STORED_NAME, board_type.name)
        ):
            raise InputError(
                f"{self.package}: its {GOOD_FILE} is of run {board.name!r}, or not of board type {board_type.name!r}.",
                action=_AGAIN,
            )
        return path.read_bytes()

    def _has(self, name: str) -> bool:
        return (self.folder / name).is_file()

    def _text(self, name: str) -> str:
        if not self._has(name):
            raise InputError(f"{self.package}: has no {name}.", action=_AGAIN)
        # It is read as JSON first, for messages with the place of a fault. The text itself has the digest.
        read_json(self.folder / name)
        return read_text(self.folder / name)

    def _document(self, model: type[M], name: str) -> M:
        return parse(model, json.loads(self._text(name)), f"{self.package}: {name}", action=_AGAIN)

    def _stored(self, document: BaseModel, name: str, *, exclude_none: bool = False) -> str:
        """Return the text that is stored of a document; InputError if it could not be read again.

        Texts such as "nan" are accepted as numbers, but JSON has none for them.
        """
        text = document.model_dump_json(exclude_none=exclude_none)
        parse(type(document), json.loads(text), f"{self.package}: {name}", action=_AGAIN)
        return text

    def _check_frames(self) -> None:
        """Decode every frame here, and refuse one of another size than its camera's.

        The station decodes frames in its own process when callers ask for them: a picture of any size would take
        its memory.
        """
        recording, known = open_recording(self.folder), set[Path]()
        for camera in range(len(recording.head.cameras)):
            for row in range(recording.head.rows):
                if (path := recording.frame_path(camera, row)) is not None:
                    known.add(path)
                    recording.frame(camera, row)
        if others := sorted(set((self.folder / "frames").rglob("*")) - known):
            raise InputError(
                f"{self.package}: {others[0].relative_to(self.folder)} is no frame of its {RECORDING_FILE}.",
                action=_AGAIN,
            )

    def _refuse_other_digest(self, name: str, document: str, expected: str) -> None:
        if digest_of(document) != expected:
            raise InputError(
                f"{self.package}: {name} has the digest {digest_of(document)}, but the run was made with {expected}.",
                action=_AGAIN,
            )


def _refuse_other_user(database: Path) -> None:
    """Refuse another user than the service's: files that it made could not be used or deleted by the station."""
    owner = database.stat().st_uid
    if owner != os.geteuid():
        raise InputError(
            f"{database}: belongs to the user with uid {owner}, but this is uid {os.geteuid()}.",
            action="Run the command as the user of the service: runuser -u vaoi -- vaoi import …",
        )


def _refuse_without_room(keep: KeepConfig, data: Path, needed: int) -> None:
    """Refuse frames that exceed the quota for recordings, or the free space of the disk."""
    free = shutil.disk_usage(data).free - DISK_RESERVE
    if needed > keep.recordings_gb * 1e9 or free < 0:
        # The frames are unpacked already, so that the free space is what they leave.
        raise DeviceError(
            f"{data}: the frames of {needed / 1e6:.0f} MB exceed [keep] recordings_gb ({keep.recordings_gb:g}), or "
            f"leave less than {DISK_RESERVE / 1e9:g} GB of the disk free.",
            action="Raise [keep] recordings_gb, free disk space, or unpack the run with --out.",
        )


@contextmanager
def _writing(path: Path) -> Iterator[sqlite3.Connection]:
    """Open the database for one transaction, which the caller commits; a running station waits for it shortly.

    Raises:
        DeviceError: the disk refuses it, or another program writes for longer than `BUSY_S`.
    """
    try:
        with closing(sqlite3.connect(path, isolation_level=None, timeout=BUSY_S)) as connection:
            connection.row_factory = sqlite3.Row
            connection.execute("PRAGMA foreign_keys = ON")
            connection.execute("PRAGMA synchronous = FULL")
            connection.execute("BEGIN IMMEDIATE")
            yield connection
    except sqlite3.Error as error:
        raise DeviceError(
            f"{path}: the run cannot be written ({error}).", action="Check space, permissions and state of the disk."
        ) from error


def _insert(connection: sqlite3.Connection, content: _Content) -> None:
    """Write a run and the documents that it refers to, and pin it; InputError if the history has it already."""
    detail, now = content.detail, utc()
    known = connection.execute("SELECT detail FROM runs WHERE id = ?", (detail.id,)).fetchone()
    if known is not None and known["detail"]:
        raise InputError(f"Run {detail.id} is in the history of this station already.", action="Nothing needs doing.")
    (pins,) = connection.execute("SELECT count(*) FROM pins").fetchone()
    if pins >= MOST_PINS:
        raise InputError(
            f"{pins} runs are pinned, which is the limit; an imported run is pinned too.",
            action="Unpin runs that are no longer needed (DELETE runs/{id}/pin).",
        )
    digests = []
    for kind, document in (("board-type", content.board_type), ("calibration", content.calibration)):
        digests.append(digest_of(document))
        connection.execute("INSERT OR IGNORE INTO documents VALUES (?, ?, ?, ?)", (digests[-1], kind, now, document))
    if content.configuration is not None:
        connection.execute(
            "INSERT OR IGNORE INTO configurations (digest, first_seen, document, last_used) VALUES (?, ?, ?, ?)",
            (digest_of(content.configuration), now, content.configuration, now),
        )
    record = packed(detail.model_dump_json())
    times = (None, None) if content.timeline is None else packed(content.timeline)
    summary = summary_of(detail).model_dump_json()
    if known is None:
        # Finish numbers of the station's own runs are above 0. Those of imported runs are below, so that no caller
        # that waits for the next run, and no later start, takes one for a board of this line.
        (lowest,) = connection.execute("SELECT min(0, coalesce(min(finish_number), 0)) FROM runs").fetchone()
        connection.execute(
            "INSERT INTO runs VALUES (?, ?, ?, ?, ?, ?, ?, ?, ?, ?, ?)",
            (
                detail.id, RunState.GONE, lowest - 1, *digests,
                summary, record[0], content.head, times[0], record[1], times[1],
            ),
        )  # fmt: skip
    else:
        connection.execute(
            """UPDATE runs SET state = ?, summary = ?, detail = ?, head = ?, timeline = ?, packed_detail = ?,
               packed_timeline = ? WHERE id = ?""",
            (RunState.GONE, summary, record[0], content.head, times[0], record[1], times[1], detail.id),
        )
        connection.execute(
            "INSERT INTO whole_runs SELECT id, finish_number, ? FROM runs WHERE id = ?",
            (int(detail.verdict is not Status.OK), detail.id),
        )
    if content.result is not None:
        connection.execute("INSERT INTO results VALUES (?, ?, ?)", (detail.id, *packed(content.result)))
    if content.heights is not None:
        connection.execute("INSERT INTO heights VALUES (?, ?, ?)", (detail.id, *packed(content.heights)))
    if content.parts is not None:
        connection.execute("INSERT INTO parts VALUES (?, ?, ?)", (detail.id, *packed(content.parts)))
    if content.identity is not None:
        write_identity(connection, detail.id, identity_row(content.identity))
    connection.execute("INSERT INTO pins VALUES (?, ?)", (detail.id, now))
