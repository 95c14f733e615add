"""Board types from the files of CAD systems and placement machines."""

from __future__ import annotations

from dataclasses import dataclass, field
from pathlib import Path
from typing import Literal, TypedDict, Unpack

from vaoi_station.board_data.import_process import OF_PERSONS, ImportTask, import_limited
from vaoi_station.errors import InputError
from vaoi_station.library.arguments import require_path
from vaoi_station.model import BoardType


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
    test_points: bool


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
            ("0,180", degrees in turn), `border` ("0x5", mm); `sizes`, a TOML file with sizes of bodies by package;
            `test_points`, False to leave out pads and vias.

    Raises:
        InputError: the file cannot be understood; the message says what to do.
    """
    function = "import_board_data"
    file = require_path(function, "path", path)
    second = None if join is None else require_path(function, "join", join)
    if side not in ("top", "bottom"):
        raise InputError.field(function, "side", side, '"top" or "bottom"')
    known = ImportChoices.__annotations__
    for name, value in choices.items():
        if name not in known:
            raise InputError.field(function, name, value, f"one of {', '.join(known)}")
        expected = bool if name == "test_points" else (str, Path) if name == "sizes" else str
        if not isinstance(value, expected):
            raise InputError.field(function, name, value, "True or False" if expected is bool else "a text")
    reply = import_limited(
        ImportTask.model_validate({"file": file, "side": side, "join": second, **choices}), OF_PERSONS
    )
    assert reply.overview is not None
    board = BoardType.model_validate_json(reply.board_type)
    return ImportedBoard(board, tuple(remark.message for remark in reply.overview.check), reply.picture)
