"""Body sizes from the names of packages, for formats that do not state them."""

from __future__ import annotations

import re
from dataclasses import replace
from functools import cache
from importlib import resources
from pathlib import Path
from typing import Any

from vaoi_station.board_data.design import Box, Design, Part
from vaoi_station.errors import InputError
from vaoi_station.files.documents import parse_toml, read_toml

Size = tuple[float, float]
Table = tuple[tuple[re.Pattern[str], Size], ...]
GUESS_MM: Size = (2.0, 2.0)
"""Size of a part of which nothing is known."""
LIMITS_MM = (0.1, 300.0)
_NAMES = tuple(
    (re.compile(pattern, re.IGNORECASE), unit_mm)
    for pattern, unit_mm in (
        # KiCad: `SOIC-8_3.9x4.9mm_P1.27mm`, `R_0603_1608Metric`.
        (r"(\d+(?:\.\d+)?)x(\d+(?:\.\d+)?)(?:x\d+(?:\.\d+)?)?mm", 1.0),
        (r"(\d{2})(\d{2})metric", 0.1),
        # IPC-7351: `CAPC1608X87`: length and width; `SOIC127P600X175`: pitch, span, (length,) height.
        (r"(?:CAP|RES|IND|LED|DIO|FUS)[CM](\d{2})(\d{2})X", 0.1),
        (r"(?:^|[^A-Z])(?:[A-Z]{2,5}\d{2,3}P)(\d{2,4})X(\d{2,4})X(\d{2,4})", 0.01),
    )
)
"""Names that state width and height in a unit."""
_HEADER = re.compile(r"Pin(?:Header|Socket)_(\d{1,3})x(\d{1,3})_P(\d+(?:\.\d+)?)mm", re.IGNORECASE)
"""KiCad: `PinHeader_1x05_P2.54mm`: pins along x and along y, and their pitch."""
_FIDUCIAL = re.compile(r"Fiducial_?(\d+(?:\.\d+)?)mm", re.IGNORECASE)
"""KiCad: `Fiducial_0.75mm_Mask1.5mm`: the diameter of the copper."""


def size_of(package: str, table: Table) -> Size | None:
    """Return the size of a body by the name of its package, at rotation 0, mm; None if the name says nothing."""
    for pattern, unit_mm in _NAMES:
        if found := pattern.search(package):
            return _plausible(float(found[1]) * unit_mm, float(found[2]) * unit_mm)
    if found := _HEADER.search(package):
        return _plausible(int(found[1]) * float(found[3]), int(found[2]) * float(found[3]))
    if found := _FIDUCIAL.search(package):
        return _plausible(float(found[1]), float(found[1]))
    return next((size for pattern, size in table if pattern.search(package)), None)


def _plausible(width: float, height: float) -> Size | None:
    low, high = LIMITS_MM
    return (width, height) if low <= min(width, height) <= max(width, height) <= high else None


@cache
def shipped_table() -> Table:
    """Return the table that comes with the package."""
    with resources.as_file(resources.files(__package__) / "package_sizes.toml") as path:
        return read_table(path)


def read_table(path: Path) -> Table:
    """Read a table of sizes; refuse wrong patterns and sizes."""
    return _table(read_toml(path), path)


def parse_table(text: str, where: str) -> Table:
    """Parse the text of a table of sizes; refuse wrong patterns and sizes."""
    return _table(parse_toml(text, where), where)


def _table(document: dict[str, Any], where: str | Path) -> Table:
    rows: Any = document.get("package")
    if not isinstance(rows, list) or not rows:
        raise InputError(f"{where}: has no [[package]] with pattern and size.")
    found = []
    for n, row in enumerate(rows):
        key = f"package.{n}"
        if not isinstance(row, dict) or set(row) != {"pattern", "size"}:
            raise InputError.field(where, key, row, "a table with pattern and size")
        pattern, size = row["pattern"], row["size"]
        numbers = isinstance(size, list) and len(size) == 2 and all(type(v) in (int, float) for v in size)
        if not numbers or not _plausible(*size):
            raise InputError.field(where, f"{key}.size", size, f"[x, y] from {LIMITS_MM[0]} to {LIMITS_MM[1]} mm")
        try:
            found.append((re.compile(str(pattern), re.IGNORECASE), (float(size[0]), float(size[1]))))
        except re.error as error:
            raise InputError.field(where, f"{key}.pattern", pattern, f"a regular expression ({error})") from error
    return tuple(found)


def with_sizes(design: Design, table: Table) -> Design:
    """Give every part without a body one from the table, or a guess, and mark it as such; on a panel of all boards."""
    parts = tuple(part if part.box is not None else _sized(part, table) for part in design.parts)
    # A panel has many boards of few designs, and the same design must stay one object.
    sized = {id(board.design): board.design for board in design.boards}
    sized = {key: with_sizes(child, table) for key, child in sized.items()}
    boards = tuple(replace(board, design=sized[id(board.design)]) for board in design.boards)
    return replace(design, parts=parts, boards=boards)


def _sized(part: Part, table: Table) -> Part:
    size = size_of(part.package, table)
    return replace(part, box=Box.of_size(*(size or GUESS_MM)), size_from="table" if size else "guess")
