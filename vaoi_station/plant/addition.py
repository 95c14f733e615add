"""Adds a recording to an archive: blobs first, the manifest last."""

from __future__ import annotations

import time
import zlib
from collections.abc import Iterator
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import Any, NamedTuple

import numpy as np
from pydantic import ValidationError

from vaoi_station.errors import DeviceError, InputError, NotFoundError
from vaoi_station.files import Recording, open_recording, read_board_type, read_calibration, read_stitch
from vaoi_station.files.documents import parse
from vaoi_station.files.images import decode, encode_png, read_image
from vaoi_station.model import Status
from vaoi_station.plant.manifest import (
    RUN_FILE,
    ArchivedReference,
    ArchivedRun,
    Blob,
    DocumentBlob,
    DocumentKind,
    FrameBlob,
    RunLabel,
    StationRecord,
    digest_of,
    frames_digest,
    read_record,
)
from vaoi_station.plant.storage import Storage

FILES: dict[DocumentKind, str] = {
    "head": "recording.json",
    "calibration": "calibration.json",
    "board_type": "board.json",
    "result": "result.json",
    "light_program": "light_program.json",
    "run": RUN_FILE,
}
REFERENCE = "reference"
"""Folder of the reference in a recording that was restored; a station keeps its references in one folder for all."""
_NEEDED: tuple[DocumentKind, ...] = ("head", "calibration", "board_type")
_SHARED: tuple[DocumentKind, ...] = ("calibration", "board_type", "light_program")
"""Documents that many runs have. They are stored as they are, because releases of zlib write different bytes."""


REWRITE_S, LONGEST_S = 12 * 3600.0, 6 * 3600.0
"""Age at which a blob is written again, and longest duration of an addition: half and a quarter of the period for which
`pruning` keeps blobs that no run needs."""


_RANK: dict[Status | None, int] = {Status.OK: 0, Status.DEGRADED: 1, Status.FAILED: 2, None: 3}


class Documents(NamedTuple):
    """Files that are given apart from the recording."""

    result: Path | None = None
    calibration: Path | None = None
    board_type: Path | None = None
    light_program: Path | None = None


@dataclass(frozen=True)
class _Content:
    paths: dict[DocumentKind, Path]
    recording: Recording

    def store(self, storage: Storage) -> tuple[dict[DocumentKind, DocumentBlob], tuple[FrameBlob, ...]]:
        """Store everything, and return the blobs of the documents and of the frames."""
        frames = tuple(_store_frames(storage, self.recording))
        return {kind: _store_document(storage, kind, path) for kind, path in self.paths.items()}, frames


def add(storage: Storage, folder: Path, given: Documents, station: str, label: RunLabel) -> ArchivedRun:
    """Store a recording; see `Archive.add`."""
    recording = open_recording(folder)
    paths = _paths(folder, given)
    board_type = read_board_type(paths["board_type"])
    read_calibration(paths["calibration"])
    # Everything is read before anything is written: a document that is invalid leaves no blobs behind.
    verdict = read_stitch(paths["result"]).status if "result" in paths else None
    record = read_record(folder)
    reference = _reference(folder, record)
    cameras = recording.head.cameras
    frames = [(i, j) for i in range(len(cameras)) for j in range(recording.head.rows)]
    known = label.run or (record.id if record else None)
    content: dict[str, Any] = {
        "run": known or f"recording-{digest_of(paths['head'].read_bytes())[:20]}",
        "station": station,
        "time": label.time or (record.started if record else _written_at(paths["head"])),
        "board_type": board_type.name,
        "revision": board_type.revision,
        "verdict": record.verdict if record else verdict,
        "serial": label.serial or (record.serial if record else None),
        "pixels": sum(cameras[i].width * cameras[i].height for i, j in frames if (i, j) not in recording.head.missing),
        "documents": {},
        "frames": (),
    }
    draft = parse(ArchivedRun, content, folder)
    began_s = time.monotonic()
    storage.write(draft.draft_key, draft.text().encode())
    documents, stored = _Content(paths, recording).store(storage)
    run = draft.model_copy(
        update={
            "run": known or frames_digest(stored),
            "documents": documents,
            "frames": stored,
            "reference": reference and _store_reference(storage, *reference),
        }
    )
    _refuse_late(storage, run, began_s)
    known_before = storage.entry(run.key) is not None
    kept = _store_manifest(storage, run)
    try:
        # Again, because a station may have let the manifest wait for hours, until no board was under way.
        _refuse_late(storage, run, began_s)
    except DeviceError:
        if not known_before:
            storage.delete(run.key)
        raise
    storage.delete(draft.draft_key)
    return kept


def _refuse_late(storage: Storage, run: ArchivedRun, began_s: float) -> None:
    """Raise DeviceError if an addition takes so long that blobs which it found there may be removed meanwhile."""
    if (taken_s := time.monotonic() - began_s) > LONGEST_S:
        raise DeviceError(
            f"{storage.url}: run {run.run} took {taken_s:.0f} s, more than {LONGEST_S:.0f} s.",
            action="Use a faster connection; adding the run again goes on where this ended.",
            code="archive-absent",
        )


def _paths(folder: Path, given: Documents) -> dict[DocumentKind, Path]:
    named = given._asdict()
    paths: dict[DocumentKind, Path] = {}
    for kind, name in FILES.items():
        path = named.get(kind) or folder / name
        if path.is_file():
            paths[kind] = path
        elif named.get(kind) or kind in _NEEDED:
            raise NotFoundError(
                f"{path}: there is no such file, and a run is not archived without it.", action=f"Give its {kind}."
            )
    return paths


def _reference(folder: Path, record: StationRecord | None) -> tuple[str, _Content] | None:
    """Return name and files of the reference against which the run was placed; None if it has none, or it is gone."""
    name = record.made_with.reference if record and record.made_with else None
    if name is None or Path(name).name != name:
        return None
    for directory in (folder / REFERENCE, folder.parent.parent / "references" / name):
        try:
            return name, _Content(_paths(directory, Documents()), open_recording(directory))
        except (NotFoundError, InputError):
            continue  # The station has deleted it, or is about to.
    return None


def _store_reference(storage: Storage, name: str, content: _Content) -> ArchivedReference | None:
    directory = content.recording.directory
    known = _STORED.get((storage.url, directory))
    if known is not None and all(_is_there(storage, blob) for blob in known.blobs):
        return known
    try:
        documents, frames = content.store(storage)
    except InputError:
        return None
    head = content.recording.head
    if len(frames) < len(head.cameras) * head.rows - len(head.missing):
        return None
    _STORED.clear()
    _STORED[storage.url, directory] = stored = ArchivedReference(run=name, documents=documents, frames=frames)
    return stored


_STORED: dict[tuple[str, Path], ArchivedReference] = {}
"""The reference that this process stored last: all runs of a board type have the same, whose files never change."""


def _store_document(storage: Storage, kind: DocumentKind, path: Path) -> DocumentBlob:
    try:
        content = path.read_bytes()
    except OSError as error:
        raise InputError(
            f"{path}: cannot be read ({error.strerror}).", action="Add the run again if its recording still exists."
        ) from error
    packed = kind not in _SHARED
    stored = zlib.compress(content, 6) if packed else content
    blob = DocumentBlob(sha256=digest_of(stored), bytes=len(stored), packed=packed)
    _store_blob(storage, blob, stored)
    return blob


def _store_frames(storage: Storage, recording: Recording) -> Iterator[FrameBlob]:
    for camera in range(len(recording.head.cameras)):
        for row in range(recording.head.rows):
            if (path := recording.frame_path(camera, row)) is not None:
                stored = encode_png(read_image(path))
                blob = FrameBlob(sha256=digest_of(stored), bytes=len(stored), camera=camera, row=row)
                _store_blob(storage, blob, stored)
                yield blob


def _store_blob(storage: Storage, blob: Blob, stored: bytes) -> None:
    # One that is damaged is replaced, not referred to again. A run is usually new, so that few blobs are read for this.
    if not _is_there(storage, blob) or digest_of(storage.read(blob.key)) != blob.sha256:
        storage.write(blob.key, stored)


def _is_there(storage: Storage, blob: Blob) -> bool:
    """Return whether a blob is there with its full size, and young enough that nothing removes it meanwhile."""
    entry = storage.entry(blob.key)
    if entry is None or entry.size != blob.bytes:
        return False
    return (datetime.now(UTC) - entry.changed).total_seconds() <= REWRITE_S


def _store_manifest(storage: Storage, run: ArchivedRun) -> ArchivedRun:
    """Write the manifest, unless the archive has the run, and return the one that the archive has."""
    content = run.text().encode()
    try:
        written = storage.read(run.key)
        before = ArchivedRun.model_validate_json(written)
    except (NotFoundError, ValidationError):
        # A damaged manifest is written again: the recording is what it was made from.
        storage.write(run.key, content)
        return run
    # A reference is deleted when its board type has another one: what was archived once stays.
    run = run.model_copy(update={"reference": before.reference or run.reference})
    content, known = run.text().encode(), before.model_copy(update={"reference": run.reference})
    if written == content:
        return before
    if _is_same(storage, known, run):
        if known != before:
            storage.write(run.key, known.text().encode())
        return known
    before = known
    if not _differs_by_record(storage, before, run):
        raise InputError(
            f"{storage.url}: has another run under the id {run.run} of station {run.station!r}.",
            action="Give this one another id, or remove the other by `vaoi archive prune`.",
        )
    if _RANK[run.verdict] < _RANK[before.verdict]:
        # The record may be an older copy, from before the verdict was lowered. It may as well be a newer one: the next
        # machine corrected the id that it had reported. The worse verdict stays.
        return before
    storage.write(run.key, content)
    return run


def _differs_by_record(storage: Storage, before: ArchivedRun, run: ArchivedRun) -> bool:
    """Return whether a run differs only by its record: the identity of a board may be found after its run was archived.

    It states another id only where it lowers the verdict.
    """
    if "run" not in run.documents:
        return False
    documents = before.documents | {"run": run.documents["run"]}
    renewed = before.model_copy(update={"verdict": run.verdict, "serial": run.serial, "documents": documents})
    lowered = _RANK[run.verdict] - _RANK[before.verdict]
    same_board = lowered > 0 or before.serial in (None, run.serial)
    return same_board and _is_same(storage, renewed, run)


def _is_same(storage: Storage, before: ArchivedRun, run: ArchivedRun) -> bool:
    """Return whether two runs differ at most in how they are compressed: releases of zlib and of this code differ."""
    stored = before.model_copy(update={"documents": run.documents, "frames": run.frames})
    if stored != run or before.documents.keys() != run.documents.keys() or len(before.frames) != len(run.frames):
        return False
    pairs = [(before.documents[kind], run.documents[kind]) for kind in run.documents]
    frames = zip(before.frames, run.frames, strict=True)
    try:
        return all(old == new or _content(storage, old) == _content(storage, new) for old, new in pairs) and all(
            old == new or _same_frame(storage, old, new) for old, new in frames
        )
    except (NotFoundError, ValueError, zlib.error):
        return False


def _same_frame(storage: Storage, one: FrameBlob, other: FrameBlob) -> bool:
    first, second = (decode(storage.read(blob.key)) for blob in (one, other))
    same = first is not None and second is not None and np.array_equal(first, second)
    return same and (one.camera, one.row) == (other.camera, other.row)


def _content(storage: Storage, blob: DocumentBlob) -> bytes:
    stored = storage.read(blob.key)
    return zlib.decompress(stored) if blob.packed else stored


def _written_at(path: Path) -> str:
    moment = datetime.fromtimestamp(path.stat().st_mtime, UTC)
    return moment.isoformat(timespec="milliseconds").replace("+00:00", "Z")
