"""The store of references: one directory per reference, in the format of `vaoi teach`, and one row in the database.

The name of a directory is the id of its run, and its content never changes. The database assigns directories to board
types. A directory that is not assigned is removed when no order and no run uses it any more.
"""

from __future__ import annotations

import hashlib
import logging
import threading
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from pydantic import TypeAdapter, ValidationError

from vaoi_station.config import MethodName
from vaoi_station.errors import DeviceError
from vaoi_station.files.directories import remove_directory
from vaoi_station.geometry import Camera
from vaoi_station.model import BoardType
from vaoi_station.runs.states.schemas import ReferenceRecord
from vaoi_station.stitching.board.reference import Reference
from vaoi_station.stitching.recordings.references import open_reference
from vaoi_station.store import Store

_log = logging.getLogger(__name__)

KEEP = "keep-all"
"""Name of an empty file in the directory of references. While it exists, no reference is deleted."""
_METHOD: TypeAdapter[MethodName] = TypeAdapter(MethodName)


@dataclass(frozen=True, eq=False)
class StoredReference:
    """A reference that was read from its directory, against which boards can be placed."""

    run: str
    directory: Path
    reference: Reference
    digest: str
    """Digest of the names, sizes and documents of its files, which never change."""


class ReferenceStore:
    """The references and the stitching methods of one station's board types. Usable from any thread."""

    def __init__(self, directory: Path, store: Store, cameras: tuple[Camera, ...]) -> None:
        """Open the store of references in `directory`. `cameras` are the cameras of the calibration in force."""
        self._directory, self._cameras = directory, cameras
        self._store = store
        self._lock = threading.Lock()
        self._opened: dict[str, tuple[BoardType, StoredReference]] = {}
        """Cache of the references that were opened last, by board type, so that arming does not wait for the disk."""

    def use_cameras(self, cameras: tuple[Camera, ...]) -> None:
        """Use the cameras of another calibration from now on: references that were filmed with others are refused."""
        with self._lock:
            self._cameras, self._opened = cameras, {}

    def method(self, board_type: str) -> MethodName | None:
        """Return the method that was set for a board type; None if the station's method applies."""
        method = self._store.methods.get(board_type)
        return None if method is None else _METHOD.validate_python(method)

    def set_method(self, board_type: str, method: MethodName | None) -> None:
        """Set the stitching method of a board type. With None, the station's method applies."""
        self._store.methods.set(board_type, method).result()

    def path_of(self, run: str) -> Path:
        """Return the directory of the reference made from a run. The directory may not exist."""
        return self._directory / run

    def has(self, board_type: str) -> bool:
        """Return whether a board type has a reference, also one that is unusable."""
        return self._store.references.get(board_type) is not None

    def record(self, board_type: str) -> ReferenceRecord | None:
        """Return the record of a board type's reference; None if it has none. DeviceError if it cannot be read."""
        document = self._store.references.get(board_type)
        try:
            return None if document is None else ReferenceRecord.model_validate_json(document)
        except ValidationError as error:
            raise DeviceError(
                f"The record of the reference of board type {board_type!r} cannot be read: it is damaged, or of a "
                "later version of the station.",
                action="Teach the reference again, or install that version.",
                code="reference-unusable",
            ) from error

    def open(self, board_type: BoardType) -> StoredReference | None:
        """Return the reference of a board type, read from disk if necessary; None if there is no reference.

        Raises:
            VaoiError: the reference is unusable: it was filmed with another calibration, the board type has changed
                since, or files are missing.
        """
        record = self.record(board_type.name)
        if record is None:
            return None
        with self._lock:
            # Board types compare by value: an edited one makes the cached reference invalid.
            known = self._opened.get(board_type.name)
            if known is None or known[0] != board_type or known[1].run != record.run:
                known = board_type, self.load(record.run, board_type)
                self._opened[board_type.name] = known
            return known[1]

    def load(self, run: str, board_type: BoardType) -> StoredReference:
        """Read the reference directory of a run, even if it is not assigned to a board type; raises as `open` does."""
        taught = open_reference(self.path_of(run), self._cameras, board_type)
        return StoredReference(run, taught.recording.directory, taught.reference, _digest_of(self.path_of(run)))

    def keep(self, board_type: str, record: ReferenceRecord) -> None:
        """Assign a reference to a board type; it replaces an earlier one."""
        self._store.references.set(board_type, record.model_dump_json()).result()

    def drop(self, board_type: str) -> None:
        """Remove the assignment of a reference to a board type, if there is one. The directory stays until `sweep`."""
        self._store.references.set(board_type, None).result()
        # An order or a run that still uses the reference holds a copy of it. If the cache held it too, the directory
        # would be kept for ever.
        with self._lock:
            self._opened.pop(board_type, None)

    def sweep(self, in_use: Collection[str] = ()) -> None:
        """Remove the directories that are neither assigned to a board type, nor open, nor `in_use`.

        `in_use` contains the ids of reference runs that orders and runs still use.
        """
        with self._lock:
            # If the database was replaced by an empty one, no reference is assigned: without this file, the next sweep
            # would delete all of them.
            keep = self._directory / KEEP
            # While the disk takes no writes, the database may be an empty one that stands in for it.
            if self._store.database.trouble is not None or self._store.database.history_unread:
                return
            if self._store.database.notices and self._directory.is_dir():
                keep.touch()
            if keep.exists():
                return
            try:
                named = {ReferenceRecord.model_validate_json(document).run for document in self._store.references.all()}
            except ValidationError as error:
                _log.warning("A record of a reference cannot be read, so no reference is removed: %s", error)
                return
            opened = {stored.run for _, stored in self._opened.values()}
            for path in self._directory.glob("*"):
                if path.name not in named | opened | {*in_use}:
                    remove_directory(path)  # What is left of it is removed by the next sweep.


def _digest_of(directory: Path) -> str:
    """Return the digest of a reference: of all names and sizes, and of the contents of the documents."""
    summary = hashlib.sha256()
    for path in sorted(path for path in directory.rglob("*") if path.is_file()):
        summary.update(f"{path.relative_to(directory)} {path.stat().st_size}\n".encode())
        if path.suffix == ".json":
            summary.update(path.read_bytes())
    return summary.hexdigest()[:16]
