"""Board types from the files of CAD systems and placement machines, here or on a running station."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, Literal, TypedDict, Unpack
from urllib.parse import quote

from vaoi_station.board_data.import_process import OF_PERSONS, ImportTask
from vaoi_station.board_data.limited_import import import_limited
from vaoi_station.demo.client import Client
from vaoi_station.errors import InputError
from vaoi_station.files.text_files import read_text
from vaoi_station.library.arguments import require_path
from vaoi_station.library.replies import checked
from vaoi_station.library.station.station_board_types import conditions
from vaoi_station.model import BoardType

PREVIEWS = "/board-data/previews"


class ImportChoices(TypedDict, total=False):
    """What a caller may say about a file; what is absent is recognised."""

    name: str
    format: str
    units: str
    columns: str
    delimiter: str
    step: str
    repeat: str
    pitch: str
    rotate: str
    border: str
    sizes: str | Path


@dataclass(frozen=True)
class ImportedBoard:
    """A board type made of board data."""

    board_type: BoardType
    check: tuple[str, ...]
    """Sentences on what a person should check."""
    picture: str = field(repr=False)
    """Outline, marks and bodies as SVG."""


def import_board_data(
    path: str | Path,
    side: Literal["top", "bottom"] = "top",
    join: str | Path | None = None,
    **choices: Unpack[ImportChoices],
) -> ImportedBoard:
    """Make a board type of one side of a design: KiCad, GenCAD, IPC-2581, ODB++, EAGLE, centroid files.

    Args:
        path: a file, or an ODB++ folder.
        side: the side that is up in the line.
        join: a second file, from which bodies, heights, outline and marks are taken.
        **choices: `name` of the board type; `format`; `units` ("mm", "inch", "mil"), `columns` ("ref=1,x=3,y=4") and
            `delimiter` of a centroid file; `step` of an ODB++ design or IPC-2581 file, a board or its panel; of the
            panel of a file of one board `repeat` ("3x2", boards along x and y), `pitch` ("30x28.5", mm), `rotate`
            ("0,180", degrees in turn), `border` ("0x5", mm); `sizes`, a TOML file with sizes of bodies by package.

    Raises:
        InputError: the file cannot be understood; the message says what to do.
    """
    file = require_path("import_board_data", "path", path)
    second = None if join is None else require_path("import_board_data", "join", join)
    if side not in ("top", "bottom"):
        raise InputError.field("import_board_data", "side", side, '"top" or "bottom"')
    _known(choices)
    task = ImportTask.model_validate({"file": file, "side": side, "join": second, **choices})
    reply = import_limited(task, OF_PERSONS)
    assert reply.overview is not None
    board = BoardType.model_validate_json(reply.board_type)
    return ImportedBoard(board, tuple(remark.message for remark in reply.overview.check), reply.picture)


@dataclass(frozen=True, eq=False)
class StationImport:
    """A file with board data on a running station, not yet a board type."""

    document: dict[str, Any]
    """What the station has found: the reply of `GET board-data/previews/{id}`."""
    _client: Client = field(repr=False)

    @classmethod
    def upload(cls, client: Client, path: str | Path, options: dict[str, Any]) -> StationImport:
        """Send a file to a station."""
        file = require_path("upload_board_data", "path", path)
        try:
            content = file.read_bytes()
        except OSError as error:
            raise InputError(f"{file}: cannot be read: {error.strerror}.") from error
        # A table of sizes may be too long for an address: the file is read again with it.
        sizes = options.pop("sizes", None)
        found = cls(dict(client.upload(PREVIEWS, content, filename=file.name, **options)), client)
        return found if sizes is None else found.correct(sizes=sizes, **options)

    @property
    def picture(self) -> bytes:
        """Outline, marks and bodies as SVG."""
        return self._client.content(f"{self._address}/picture")

    def correct(self, **options: Any) -> StationImport:
        """Read the file again with other options: `side`, `join` (id of another upload), and as for the upload."""
        if options.get("sizes") is not None:
            options["sizes"] = read_text(require_path("correct", "sizes", options["sizes"]))
        reply = self._client.put_document(self._address, {k: v for k, v in options.items() if v is not None})
        return StationImport(dict(reply), self._client)

    def confirm(self, *, tag: str | None = None, new: bool = False) -> BoardType:
        """Store the board type on the station, so that it can be armed.

        Args:
            tag: replace only the version with this tag (`StationBoardTypes.get_tagged`).
            new: replace none: refuse with the code `changed` if there is a board type of this name.
        """
        path = f"{self._address}/confirm"
        return checked(BoardType, self._client.post_under(path, conditions(tag, new=new)), self._client.url(path))

    def board_type(self) -> BoardType:
        """Return the board type that `confirm` would store."""
        path = f"{self._address}/board-type"
        return checked(BoardType, self._client.get(path), self._client.url(path))

    def discard(self) -> None:
        """Delete the file from the station; without this call it goes after an hour."""
        self._client.delete(self._address)

    @property
    def _address(self) -> str:
        return f"{PREVIEWS}/{quote(str(self.document['id']))}"


def _known(choices: ImportChoices) -> None:
    """Raise InputError for a choice that is no text, or has an unknown name."""
    for name, value in choices.items():
        known = ", ".join(ImportChoices.__annotations__)
        if name not in ImportChoices.__annotations__:
            raise InputError.field("import_board_data", name, value, f"one of {known}")
        if not isinstance(value, (str, Path) if name == "sizes" else str):
            raise InputError.field("import_board_data", name, value, "a text")
