"""Board types as files, NAME.json each: readable, editable, copied from line to line."""

from __future__ import annotations

from dataclasses import dataclass
from pathlib import Path
from urllib.parse import quote

from vaoi_station.errors import InputError, NotFoundError, VaoiError
from vaoi_station.files import read_board_type, write_board_type
from vaoi_station.model import BoardType

LONGEST_FILE_NAME = 250


@dataclass(frozen=True)
class BoardTypeFile:
    """One file of the directory: a board type, or why it cannot be used."""

    path: Path
    board_type: BoardType | None
    fault: VaoiError | None


class BoardTypeDirectory:
    """The board types somebody taught this station."""

    def __init__(self, directory: Path) -> None:
        self.directory = directory

    def get(self, name: str) -> BoardType:
        """One board type; `NotFoundError` with the names there are."""
        path = self.path_of(name)
        if not path.is_file():
            known = ", ".join(repr(f.board_type.name) for f in self.list() if f.board_type) or "none yet"
            raise NotFoundError(
                f"There is no board type {name!r}; taught are: {known}.",
                action="Teach it (PUT its placement data under board-types), or arm with one of these.",
                code="unknown-board-type",
            )
        return self._read(path)

    def list(self) -> list[BoardTypeFile]:
        """All files of the directory, by name; unusable ones with their fault."""
        return [self._entry(path) for path in sorted(self.directory.glob("*.json")) if not path.name.startswith(".")]

    def put(self, board_type: BoardType) -> bool:
        """Write a board type whole or not at all; True if the name is new."""
        path = self.path_of(board_type.name)
        new = not path.exists()
        write_board_type(path, board_type)
        return new

    def delete(self, name: str) -> None:
        """Forget a board type; `NotFoundError` if there is none of that name."""
        try:
            self.path_of(name).unlink()
        except FileNotFoundError:
            raise NotFoundError(f"There is no board type {name!r}.", code="unknown-board-type") from None

    def path_of(self, name: str) -> Path:
        """The file of a name; characters that file systems mind are written as %XX."""
        stem = quote(name, safe=" ()+,;=@&!#'")
        if stem.startswith("."):
            stem = "%2E" + stem[1:]
        if not name or len(stem) > LONGEST_FILE_NAME:
            raise InputError.field("board type", "name", name, f"1 … {LONGEST_FILE_NAME} characters as a file name")
        return self.directory / f"{stem}.json"

    def _entry(self, path: Path) -> BoardTypeFile:
        try:
            return BoardTypeFile(path, self._read(path), None)
        except VaoiError as error:
            return BoardTypeFile(path, None, error)

    def _read(self, path: Path) -> BoardType:
        board_type = read_board_type(path)
        if (expected := self.path_of(board_type.name)) != path:
            raise InputError(
                f"{path}: holds the board type {board_type.name!r}.",
                action=f"Rename the file to {expected.name}, or correct the name in it.",
            )
        return board_type
