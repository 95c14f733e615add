"""The references of the board types: directories as `vaoi teach` makes them, and a row of the store for each.

A directory is named by its run and never changes; the store says which of them is whose reference. What
it does not name is swept away as soon as nobody uses it any more.
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
class Shelved:
    """A reference that boards can be placed against."""

    run: str
    directory: Path
    reference: Reference


class ReferenceShelf:
    """How the board types of one station are stitched, and against what; any thread may ask."""

    def __init__(self, directory: Path, store: Store, cameras: tuple[Camera, ...]) -> None:
        """`directory`: where the references are; `cameras`: as they are calibrated now."""
        self._directory, self._cameras = directory, cameras
        self._kept = store.stitching
        self._lock = threading.Lock()
        self._opened: dict[str, tuple[BoardType, Shelved]] = {}
        """By board type: what was opened last, so that arming does not wait for the disk."""

    def method(self, board_type: str) -> MethodName | None:
        """The board type's own way to stitch; None if the station's holds."""
        method = self._kept.method(board_type)
        return None if method is None else _METHOD.validate_python(method)

    def set_method(self, board_type: str, method: MethodName | None) -> None:
        """Give a board type a way of its own, or take it away."""
        kept = self._kept
        (kept.drop_method(board_type) if method is None else kept.keep_method(board_type, method)).result()

    def path_of(self, run: str) -> Path:
        """Where a run is kept as a reference."""
        return self._directory / run

    def record(self, board_type: str) -> ReferenceRecord | None:
        """What a board type's reference is made of; None if it has none."""
        document = self._kept.reference(board_type)
        return None if document is None else ReferenceRecord.model_validate_json(document)

    def open(self, board_type: BoardType) -> Shelved | None:
        """The reference of a board type; None if it has none.

        Raises:
            VaoiError: it was filmed with another calibration, or the board type has changed, or files are gone.
        """
        record = self.record(board_type.name)
        if record is None:
            return None
        with self._lock:
            known = self._opened.get(board_type.name)
            if known is None or known[0] != board_type or known[1].run != record.run:
                known = board_type, self.look_at(record.run, board_type)
                self._opened[board_type.name] = known
            return known[1]

    def look_at(self, run: str, board_type: BoardType) -> Shelved:
        """A run that is kept as a reference, whoever's it is; raises as `open` does."""
        taught = open_reference(self.path_of(run), self._cameras, board_type)
        return Shelved(run, taught.recording.directory, taught.reference)

    def keep(self, board_type: str, record: ReferenceRecord) -> None:
        """Give a board type a reference in place of the one it has."""
        self._kept.keep_reference(board_type, record.model_dump_json()).result()

    def drop(self, board_type: str) -> None:
        """A board type has no reference any more; harmless if it had none."""
        self._kept.drop_reference(board_type).result()

    def sweep(self, in_use: Collection[str] = ()) -> None:
        """Remove directories that are nobody's reference, were not opened last, and are not `in_use` by a run."""
        with self._lock:
            named = {ReferenceRecord.model_validate_json(document).run for document in self._kept.references()}
            opened = {shelved.run for _, shelved in self._opened.values()}
            for path in self._directory.glob("*"):
                if path.name not in named | opened | {*in_use}:
                    shutil.rmtree(path, ignore_errors=True)  # what cannot be removed is tried again next time
