"""Board types as files, one NAME.json each, so that they can be edited and copied between lines."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote, unquote

from vaoi_station.errors import InputError, NotFoundError, StateError, VaoiError
from vaoi_station.files import read_board_type, write_board_type
from vaoi_station.files.durability import sync_directory
from vaoi_station.model import BoardType
from vaoi_station.store.board_type_revisions import BoardTypeRevision, BoardTypeRevisions

MOST_FILES, MOST_BYTES = 500, 128 * 2**20
"""Limits of the directory: number of files, bytes. Without them, a program that stores board types could fill the
disk."""
LONGEST_FILE_NAME = 250
"""Largest number of characters of a file name without ".json". Common file systems allow 255 bytes for the whole
name."""


@dataclass(frozen=True)
class BoardTypeFile:
    """One file of the directory: a board type, or the fault that makes it unusable."""

    path: Path
    board_type: BoardType | None
    fault: VaoiError | None


class BoardTypeDirectory:
    """The directory with the station's board types."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory
        self.revisions = BoardTypeRevisions(directory)

    def get(self, name: str) -> BoardType:
        """Read one board type; raise `NotFoundError` with the known names if it does not exist."""
        path = self.path_of(name)
        if not path.is_file():
            # The names come from the names of the files: reading many files takes seconds.
            known = _enumeration([unquote(path.stem) for path in self.paths()]) or "none yet"
            raise NotFoundError(
                f"There is no board type {name!r}; known board types: {known}.",
                action="Store it (PUT its placement data under board-types), or arm with one of these.",
                code="unknown-board-type",
            )
        return self._read(path)

    def list(self) -> list[BoardTypeFile]:
        """Return one entry per file, sorted by name. The entry of an unusable file holds the fault."""
        return [self.entry(path) for path in self.paths()]

    def paths(self) -> tuple[Path, ...]:
        """Return the paths of all files, sorted by name."""
        # Names with a leading dot are temporary files of an unfinished write.
        return tuple(p for p in sorted(self.directory.glob("*.json")) if not p.name.startswith("."))

    def put(self, board_type: BoardType) -> bool:
        """Write a board type atomically; return True if the name is new. `StateError` if there are too many.

        The version before is kept (`revisions`).
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
        kept = None if new else self.revisions.keep(path)
        try:
            write_board_type(path, board_type)
        except BaseException:  # nothing was replaced; the error is raised again
            if kept is not None:
                self.revisions.discard(kept)
            raise
        if kept is not None:
            if kept.read_bytes() == path.read_bytes():
                self.revisions.discard(kept)
            else:
                self.revisions.bound(kept)
        return new

    def delete(self, name: str) -> None:
        """Delete a board type; raise `NotFoundError` if it does not exist. Its last version is kept (`revisions`)."""
        path = self.path_of(name)
        if not path.is_file():
            raise _unknown(name)
        kept = self.revisions.keep(path)
        path.unlink(missing_ok=True)
        sync_directory(self.directory)
        self.revisions.bound(kept)

    def deleted(self) -> tuple[str, ...]:
        """Return the names of board types of which only versions are left, sorted."""
        present = {path.stem for path in self.paths()}
        return tuple(unquote(stem) for stem in self.revisions.stems() if stem not in present)

    def revisions_of(self, name: str) -> tuple[BoardTypeRevision, ...]:
        """Return the versions of a board type, newest first; `NotFoundError` if the name never existed."""
        path = self.path_of(name)
        found = self.revisions.list(path.stem)
        if not found and not path.is_file():
            raise _unknown(name)
        return found

    def revision(self, name: str, revision: str) -> BoardType:
        """Read one version of a board type; `NotFoundError` if there is none, `InputError` if it cannot be used."""
        return read_board_type(self.revisions.get(self.path_of(name).stem, revision).path)

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


def _enumeration(names: Sequence[str]) -> str:
    """Return names as text for a message; if there are many, only the first ones."""
    shown = ", ".join(map(repr, names[:20]))
    return f"{shown} and {len(names) - 20} more" if len(names) > 20 else shown


def _unknown(name: str) -> NotFoundError:
    """Return the refusal of a board type that there is not."""
    action = "See the list of board types."
    return NotFoundError(f"There is no board type {name!r}.", action=action, code="unknown-board-type")
