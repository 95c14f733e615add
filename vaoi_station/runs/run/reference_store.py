"""The references of the board types: directories as `vaoi teach` makes them, and a row of the database for each.

A directory is named by its run and never changes; the database assigns it to a board type. Directories that it does not
name are removed when no order and no run uses them.
"""

from __future__ import annotations

import shutil
import threading
from collections.abc import Collection
from dataclasses import dataclass
from pathlib import Path

from pydantic import TypeAdapter

from vaoi_station.config import MethodName
from vaoi_station.geometry import Camera
from vaoi_station.model import BoardType
from vaoi_station.runs.states.schemas import ReferenceRecord
from vaoi_station.stitching.board.reference import Reference
from vaoi_station.stitching.recordings.reference_directory import open_reference
from vaoi_station.store import Store

_METHOD: TypeAdapter[MethodName] = TypeAdapter(MethodName)


@dataclass(frozen=True, eq=False)
class StoredReference:
    """A reference that is ready for placing boards."""

    run: str
    directory: Path
    reference: Reference


class ReferenceStore:
    """Methods and references of the board types of one station; usable from any thread."""

    def __init__(self, directory: Path, store: Store, cameras: tuple[Camera, ...]) -> None:
        """Open the references in `directory`, for cameras as they are calibrated now."""
        self._directory, self._cameras = directory, cameras
        self._kept = store.stitching
        self._lock = threading.Lock()
        self._opened: dict[str, tuple[BoardType, StoredReference]] = {}
        """The reference opened last, by board type: arming does not wait for the disk."""

    def method(self, board_type: str) -> MethodName | None:
        """Return the board type's own method; None if that of the station applies."""
        method = self._kept.method(board_type)
        return None if method is None else _METHOD.validate_python(method)

    def set_method(self, board_type: str, method: MethodName | None) -> None:
        """Give a board type a method of its own; None removes it."""
        kept = self._kept
        (kept.drop_method(board_type) if method is None else kept.keep_method(board_type, method)).result()

    def path_of(self, run: str) -> Path:
        """Directory of a run that is kept as a reference."""
        return self._directory / run

    def record(self, board_type: str) -> ReferenceRecord | None:
        """Return the record of a board type's reference; None if it has none."""
        document = self._kept.reference(board_type)
        return None if document is None else ReferenceRecord.model_validate_json(document)

    def open(self, board_type: BoardType) -> StoredReference | None:
        """Return the reference of a board type; None if it has none.

        Raises:
            VaoiError: it was filmed with another calibration, or the board type has changed, or files are gone.
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
        """Read a run that is kept as a reference, whether or not a board type names it; raises as `open` does."""
        taught = open_reference(self.path_of(run), self._cameras, board_type)
        return StoredReference(run, taught.recording.directory, taught.reference)

    def keep(self, board_type: str, record: ReferenceRecord) -> None:
        """Set the reference of a board type, in place of an earlier one."""
        self._kept.keep_reference(board_type, record.model_dump_json()).result()

    def drop(self, board_type: str) -> None:
        """Remove the reference of a board type; harmless if it has none."""
        self._kept.drop_reference(board_type).result()

    def sweep(self, in_use: Collection[str] = ()) -> None:
        """Remove directories that no board type names, that are not open, and that no run has `in_use`."""
        with self._lock:
            named = {ReferenceRecord.model_validate_json(document).run for document in self._kept.references()}
            opened = {stored.run for _, stored in self._opened.values()}
            for path in self._directory.glob("*"):
                if path.name not in named | opened | {*in_use}:
                    shutil.rmtree(path, ignore_errors=True)  # retried at the next sweep
