"""Read and write board.json."""

from __future__ import annotations

from pathlib import Path

from vaoi_station.files.documents import parse, read_json, write_json
from vaoi_station.model import BoardType


def read_board_type(path: Path) -> BoardType:
    """Read a board type; raise InputError with file, key and value if it is invalid."""
    return parse(BoardType, read_json(path), path)


def write_board_type(path: Path, board_type: BoardType) -> None:
    """Write a board type atomically: readers see either the old file or the complete new one."""
    write_json(path, board_type.model_dump(mode="json", exclude_none=True))
