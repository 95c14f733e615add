"""Board types as files, one NAME.json each, so that they can be edited and copied between lines."""

from __future__ import annotations

import hashlib
import os
import re
import shutil
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from datetime import UTC, datetime
from pathlib import Path
from typing import NamedTuple
from urllib.parse import quote, unquote

from vaoi_station.errors import DeviceError, InputError, NotFoundError, StateError, VaoiError
from vaoi_station.files import read_board_type, write_board_type
from vaoi_station.files.directories import make_directories, sync_directory, sync_file
from vaoi_station.model import BoardType

_MOST_REMEMBERED = 8
MOST_FILES, MOST_BYTES = 500, 128 * 2**20
"""Limits of the directory: number of files, bytes."""
LONGEST_FILE_NAME = 250
"""Largest number of characters of a file name without ".json"; common file systems allow 255 bytes in all."""
LATEST = "latest"
"""Name of the version that ended last: the one before the present."""
FOLDER = ".revisions"
MOST_OF_TYPE, MOST_REVISIONS, MOST_REVISION_BYTES = 20, 2000, 128 * 2**20
"""Limits: versions of one board type, versions of all, and their size in all."""
_ID = re.compile(r"[0-9]{8}T[0-9]{9}Z-[0-9a-f]{8}")


@dataclass(frozen=True)
class BoardTypeFile:
    """One file of the directory: a board type, or the fault that makes it unusable."""

    path: Path
    board_type: BoardType | None
    fault: VaoiError | None


class BoardTypeRevision(NamedTuple):
    """One version of a board type that is no longer in force."""

    id: str
    path: Path
    stored: datetime
    """Time at which the version was written."""
    ended: datetime
    """Time at which the version was replaced or deleted."""
    size_bytes: int

    @property
    def in_force_s(self) -> float:
        """Time for which the version was in force, s; 0 if the clock was set back meanwhile."""
        return max(0.0, (self.ended - self.stored).total_seconds())


class BoardTypeDirectory:
    """The directory with the station's board types, and their versions from before they were replaced or deleted."""

    def __init__(self, directory: Path) -> None:
        self.directory, self._versions = directory, directory / FOLDER
        self._read_last: dict[Path, tuple[tuple[int, int, int], BoardType]] = {}
        """Board types that were read last, with the state of the file: the next order mostly has one of them."""

    def get(self, name: str) -> BoardType:
        """Read one board type; raise `NotFoundError` with the known names if it does not exist."""
        path = self.path_of(name)
        try:
            status = path.stat()
        except FileNotFoundError as absent:
            # The names come from the names of the files: reading many files takes seconds.
            known = _enumeration([unquote(path.stem) for path in self.paths()]) or "none yet"
            raise NotFoundError(
                f"There is no board type {name!r}; known board types: {known}.",
                action="Store it (PUT its placement data under board-types), or arm with one of these.",
                code="unknown-board-type",
            ) from absent
        state = status.st_mtime_ns, status.st_size, status.st_ino
        kept = self._read_last.get(path)
        if kept is None or kept[0] != state:
            kept = self._read_last[path] = state, self._read(path)
            for other in list(self._read_last)[:-_MOST_REMEMBERED]:
                self._read_last.pop(other, None)
        return kept[1]

    def list(self) -> list[BoardTypeFile]:
        """Return one entry per file, sorted by name. The entry of an unusable file holds the fault."""
        return [self.entry(path) for path in self.paths()]

    def paths(self) -> tuple[Path, ...]:
        """Return the paths of all files, sorted by name."""
        # Names with a leading dot are temporary files of an unfinished write.
        return tuple(p for p in sorted(self.directory.glob("*.json")) if not p.name.startswith("."))

    def put(self, board_type: BoardType) -> bool:
        """Write a board type atomically, and keep the version before; return True if the name is new.

        Raises:
            StateError: too many board types are stored.
            DeviceError: the disk refuses it; nothing was changed.
        """
        path = self.path_of(board_type.name)
        new = not path.exists()
        others = [p for p in self.paths() if p != path]
        if len(others) >= MOST_FILES or sum(p.stat().st_size for p in others) >= MOST_BYTES:
            raise StateError(
                f"{len(others)} board types are stored, the limit is {MOST_FILES}, or {MOST_BYTES >> 20} MB in all.",
                action="Delete board types that are no longer filmed.",
                code="too-many-board-types",
            )
        kept = None if new else self._keep(path)
        try:
            write_board_type(path, board_type)
        except BaseException:  # nothing was replaced; the error is raised again
            if kept is not None:
                kept.unlink(missing_ok=True)
            raise
        if kept is not None:
            if kept.read_bytes() == path.read_bytes():
                kept.unlink()
            else:
                self._bound(kept)
        return new

    def delete(self, name: str) -> None:
        """Delete a board type; raise `NotFoundError` if it does not exist. Its last version is kept."""
        path = self.path_of(name)
        if not path.is_file():
            raise _unknown(name)
        kept = self._keep(path)
        path.unlink(missing_ok=True)
        sync_directory(self.directory)
        self._bound(kept)

    def deleted(self) -> tuple[str, ...]:
        """Return the names of board types of which only versions are left, sorted."""
        present = {path.stem for path in self.paths()}
        return tuple(unquote(stem) for stem in self._stems() if stem not in present)

    def revisions_of(self, name: str) -> tuple[BoardTypeRevision, ...]:
        """Return the versions of a board type, newest first; `NotFoundError` if the name never existed."""
        path = self.path_of(name)
        found = self._revisions(path.stem)
        if not found and not path.is_file():
            raise _unknown(name)
        return found

    def revision(self, name: str, revision: str) -> BoardType:
        """Read one version of a board type; `NotFoundError` if there is none, `InputError` if it cannot be used."""
        found = next((r for r in self._revisions(self.path_of(name).stem) if revision in (r.id, LATEST)), None)
        if found is None:
            raise NotFoundError(
                f"There is no version {revision!r:.80} of this board type.",
                action="List its revisions; old ones are deleted when there are many.",
                code="unknown-revision",
            )
        return read_board_type(found.path)

    def path_of(self, name: str) -> Path:
        """Return the file path of a board type; characters that file systems reject are written as %XX.

        Raises:
            InputError: the name is empty or too long for a file name.
        """
        # The escape is reversible, so that two names never share a file; "/" and ":" cannot leave the directory.
        stem = quote(name, safe=" ()+,;=@&!#'")
        # This also covers "." and "..", which would be directories.
        if stem.startswith("."):
            stem = "%2E" + stem[1:]
        if not name or len(stem) > LONGEST_FILE_NAME:
            raise InputError.field("board type", "name", name, f"1 … {LONGEST_FILE_NAME} characters as a file name")
        return self.directory / f"{stem}.json"

    def entry(self, path: Path) -> BoardTypeFile:
        """Read one file; a fault of it is part of the entry."""
        try:
            return BoardTypeFile(path, self._read(path), None)
        except VaoiError as error:
            return BoardTypeFile(path, None, error)

    def _read(self, path: Path) -> BoardType:
        board_type = read_board_type(path)
        # A copy of a file under a new name may still contain the old board type name; `path_of` would never find the
        # copy.
        if (expected := self.path_of(board_type.name)) != path:
            raise InputError(
                f"{path}: holds the board type {board_type.name!r}.",
                action=f"Rename the file to {expected.name}, or correct the name in it.",
            )
        return board_type

    def _keep(self, path: Path) -> Path:
        now = datetime.now(UTC)
        try:
            digest = hashlib.sha256(path.read_bytes()).hexdigest()[:8]
            name = f"{now:%Y%m%dT%H%M%S}{now.microsecond // 1000:03d}Z-{digest}.json"
            kept = self._versions / path.stem / name
            make_directories(kept.parent)
            kept.unlink(missing_ok=True)
            try:
                os.link(path, kept)  # a link keeps the time at which the version was written
            except OSError:
                shutil.copy2(path, kept)  # the file system has no links
                sync_file(kept)
            # On the disk before what it is kept from: the file that replaces it, or its deletion.
            sync_directory(kept.parent)
        except OSError as error:
            raise DeviceError(
                f"{path}: the present version cannot be kept ({error.strerror}), so nothing was changed.",
                action="Check space and permissions of the directory of board types.",
                code="revision-not-kept",
            ) from error
        return kept

    def _bound(self, kept: Path) -> None:
        """Delete versions until the limits hold; `kept` stays."""
        own = self._revisions(kept.parent.name)
        for old in _to_delete([r for r in own if r.path != kept], len(own) - MOST_OF_TYPE, 0):
            old.path.unlink(missing_ok=True)
        everything = [r for stem in self._stems() for r in self._revisions(stem)]
        size = sum(r.size_bytes for r in everything)
        others = [r for r in everything if r.path != kept]
        for old in _to_delete(others, len(everything) - MOST_REVISIONS, size - MOST_REVISION_BYTES):
            old.path.unlink(missing_ok=True)

    def _stems(self) -> tuple[str, ...]:
        if not self._versions.is_dir():
            return ()
        return tuple(sorted(folder.name for folder in self._versions.iterdir() if any(folder.glob("*.json"))))

    def _revisions(self, stem: str) -> tuple[BoardTypeRevision, ...]:
        found = []
        for path in (self._versions / stem).glob("*.json"):
            if not _ID.fullmatch(path.stem):
                continue
            try:
                status = path.stat()
            except FileNotFoundError:
                continue  # deleted meanwhile
            ended = datetime.strptime(path.stem[:18] + "000", "%Y%m%dT%H%M%S%f").replace(tzinfo=UTC)
            stored = datetime.fromtimestamp(status.st_mtime, UTC)
            found.append(BoardTypeRevision(path.stem, path, stored, ended, status.st_size))
        return tuple(sorted(found, reverse=True))


def _enumeration(names: Sequence[str]) -> str:
    """Return names as text for a message; if there are many, only the first ones."""
    shown = ", ".join(map(repr, names[:20]))
    return f"{shown} and {len(names) - 20} more" if len(names) > 20 else shown


def _unknown(name: str) -> NotFoundError:
    """Return the refusal of a board type that there is not."""
    action = "See the list of board types."
    return NotFoundError(f"There is no board type {name!r}.", action=action, code="unknown-board-type")


def _to_delete(revisions: Iterable[BoardTypeRevision], count: int, size: int) -> list[BoardTypeRevision]:
    """Return the versions that were in force for the shortest time: at least `count`, and `size` bytes in all."""
    chosen: list[BoardTypeRevision] = []
    for revision in sorted(revisions, key=lambda r: (r.in_force_s, r.ended)):
        if count <= 0 and size <= 0:
            break
        chosen.append(revision)
        count, size = count - 1, size - revision.size_bytes
    return chosen
