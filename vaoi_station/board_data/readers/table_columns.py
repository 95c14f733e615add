"""Recognise how a centroid file is laid out: its delimiter, its header and what its columns hold."""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from vaoi_station.board_data.design import Side
from vaoi_station.board_data.source_text import number_of
from vaoi_station.errors import InputError

COLUMNS = ("ref", "x", "y", "rotation", "side", "package", "value", "fitted")
REQUIRED = ("ref", "x", "y")

_NOT_FITTED = frozenset(
    {
        "dnp", "dni", "dnf", "dns", "nopop", "nofit", "notfitted", "notpopulated", "notmounted", "unpopulated",
        "unfitted", "donotplace", "donotpopulate", "donotfit", "donotinstall", "donotstuff",
    }
)  # fmt: skip
"""What a header or a cell says of a part that is not fitted."""
_YES, _NO = frozenset({"yes", "y", "true", "1", "x"}), frozenset({"no", "n", "false", "0"})
_NAMES: dict[str, tuple[str, ...]] = {
    "ref": ("ref", "refdes", "designator", "reference", "referencedesignator", "part", "component", "name", "id"),
    "x": (
        "x",
        "posx",
        "midx",
        "centerx",
        "centrex",
        "xcenter",
        "refx",
        "locationx",
        "xlocation",
        "xcoord",
        "xpos",
        "partx",
    ),
    "y": (
        "y",
        "posy",
        "midy",
        "centery",
        "centrey",
        "ycenter",
        "refy",
        "locationy",
        "ylocation",
        "ycoord",
        "ypos",
        "party",
    ),
    "rotation": ("rot", "rotation", "angle", "orientation", "theta", "r"),
    "side": ("side", "layer", "tb", "boardside", "placementside", "mirror"),
    "package": ("package", "footprint", "pattern", "decal", "symname", "pkg", "case", "shape"),
    "value": ("val", "value", "comment", "partnumber", "device", "devtype"),
    "fitted": ("fitted", "populate", "populated", "mounted", "assembled", "stuffed", *sorted(_NOT_FITTED)),
}
NUMBER = re.compile(r"^([+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][+-]?\d+)?)\s*(mm|mils?|inch|in|\"|°|deg)?$")
_REF = re.compile(r"^[A-Za-z*_][\w*.\-/+$]*$")


@dataclass(frozen=True)
class TableLayout:
    """What the columns of a table hold."""

    columns: Mapping[str, int]
    first: int
    """Index of the first line with a part."""
    all_on: Side | None = None
    """The side of all parts, as the user states it."""
    width: int = 0
    """Number of columns; 0 without a header."""
    headers: tuple[str, ...] = ()

    def header_of(self, name: str) -> str:
        """Return the header of a column; empty without one."""
        at = self.columns.get(name, self.width)
        return self.headers[at] if at < len(self.headers) else ""

    def aligned(self, row: list[str]) -> list[str]:
        """Return a line whose value has spaces, or none at all, with as many cells as the header has."""
        at, surplus = self.columns.get("value"), len(row) - self.width
        if not self.width or at is None or surplus == 0 or surplus < -1:
            return row
        return [
            *row[:at],
            *([" ".join(row[at : at + surplus + 1])] if surplus > 0 else [""]),
            *row[at + max(surplus, -1) + 1 :],
        ]


def find_delimiter(lines: Sequence[str]) -> str:
    """Return the delimiter that makes a header of one line, or designator, x and y of most lines."""
    sample = [line for line in lines[:400] if line.strip()]

    def fitness(delimiter: str) -> tuple[int, int]:
        rows = [cells_of(line, delimiter) for line in sample]
        header = max((len(found) for row in rows if _has_required(found := _named_columns(row))), default=0)
        return header, sum(map(_is_bare_part, rows))

    return max(("\t", ";", "|", ",", " "), key=fitness)


def _has_required(columns: Mapping[str, int]) -> bool:
    return all(name in columns for name in REQUIRED)


def _is_bare_part(row: Sequence[str]) -> bool:
    """Return whether a line without a header is designator, x, y and rotation."""
    return len(row) >= 4 and bool(_REF.match(row[0])) and all(number_in(c) is not None for c in row[1:4])


def cells_of(line: str, delimiter: str) -> list[str]:
    """Return the cells of a line."""
    if delimiter == " ":
        return [quoted or plain for quoted, plain in re.findall(r'"([^"]*)"|(\S+)', line)]
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]
    except csv.Error:  # a quotation mark within a cell
        return [cell.strip() for cell in line.split(delimiter)]


def plain_key(cell: str) -> str:
    """Return a header without case, unit and punctuation: `Center-X(mm)` is `centerx`."""
    return re.sub(r"[^a-z]", "", re.sub(r"[\(\[].*?[\)\]]", "", cell.lower()))


def find_layout(rows: Sequence[list[str]], path: Path, given: Sequence[tuple[str, str]]) -> TableLayout:
    """Return what the columns hold, by a header or by the lines, and by what the user has `given` for a column."""
    header = -1
    columns: dict[str, int] = {}
    for n, row in enumerate(rows[:200]):
        found = _named_columns(row)
        if _has_required(found):
            header, columns = n, found
            break
    cells = [c for c in rows[header] if c not in ("#", "!", "%")] if header >= 0 else []
    # Lines may have more cells than the header: columns without a name.
    most = max(map(len, rows[max(header, 0) :]), default=0)
    all_on: Side | None = None
    for name, at in given:
        if name == "side" and at.lower() in ("top", "bottom"):
            all_on = "top" if at.lower() == "top" else "bottom"
            columns.pop(name, None)
        else:
            columns[name] = _column(path, name, at, cells, most)
    if header < 0 and not _has_required(columns):
        columns = _without_header(rows, path)
    missing = [name for name in REQUIRED if name not in columns]
    if missing:
        raise InputError(
            f"{path}: no column is recognised as {', '.join(missing)}. Name it by --columns {missing[0]}=N."
        )
    return TableLayout(columns, header + 1, all_on, len(cells), tuple(cells))


def _named_columns(row: Sequence[str]) -> dict[str, int]:
    cells = [c for c in row if c not in ("#", "!", "%")]  # a header in a comment: `# Ref Val Package …`
    keys = [plain_key(cell.lstrip("#!% ")) for cell in cells]
    found: dict[str, int] = {}
    for name, words in _NAMES.items():
        # The words are in the order of preference: with "Mid X" and "Ref X" the former is the body's centre.
        for word in words:
            if word in keys and keys.index(word) not in found.values():
                found[name] = keys.index(word)
                break
    return found


def _column(path: Path, name: str, at: str, header: Sequence[str], most: int) -> int:
    """Return the index of a column that is given by its header, or by a number up to `most`."""
    if re.fullmatch(r"[0-9]{1,6}", at) and 1 <= int(at) <= most:
        return int(at) - 1
    keys = [plain_key(cell) for cell in header]
    if plain_key(at) and plain_key(at) in keys:
        return keys.index(plain_key(at))
    raise InputError.field(path, f"--columns {name}", at, f"a number from 1 to {most}, or a header of {list(header)}")


def _without_header(rows: Sequence[list[str]], path: Path) -> dict[str, int]:
    """Return the columns of a table without a header: designator, x, y, rotation, then side or package (Allegro)."""
    usual = [row for row in rows if _is_bare_part(row)]
    if 2 * len(usual) < sum(len(row) > 1 for row in rows) or not usual:
        raise InputError(
            f"{path}: has no header with columns {', '.join(REQUIRED)}, and its lines are not designator, x, y, "
            "rotation. Name the columns by --columns, for example --columns ref=1,x=3,y=4,rotation=5."
        )
    found = {"ref": 0, "x": 1, "y": 2, "rotation": 3}
    if all(len(row) == 6 and row[4] != "m" for row in usual):  # EAGLE's .mnt
        found |= {"value": 4, "package": 5}
    elif any(len(row) == 5 for row in usual):
        found["package"] = 4
    return found


def number_in(cell: str) -> float | None:
    """Return the number of a cell, which may have a decimal comma and a unit; None if it has none."""
    match = NUMBER.match(cell.strip())
    return number_of(match[1].replace(",", ".")) if match else None


def is_fitted(cell: str, header: str, value: str) -> bool:
    """Return whether a part is fitted, by its cell of the column `fitted`, the header of that column, and its value."""
    if _NOT_FITTED & {plain_key(cell), plain_key(value)}:
        return False
    word = cell.strip().lower()
    # A column "DNP" states of which parts the opposite holds.
    return word not in _YES if plain_key(header) in _NOT_FITTED else word not in _NO
