"""Read centroid files: tables of parts with place, rotation and side, as CAD systems and placement machines write them.

Delimiter, decimal comma, unit and columns are recognised from the file. What was recognised is reported, and every item
can be given by the user instead. x and y are taken as seen from the top.
"""

from __future__ import annotations

import csv
import re
from collections.abc import Mapping, Sequence
from dataclasses import dataclass
from pathlib import Path

from vaoi_station.board_data.design import Design, Part, Side, TableReading, normalised
from vaoi_station.board_data.source_text import decode, number_of
from vaoi_station.errors import InputError

UNITS = {"mm": 1.0, "inch": 25.4, "mil": 0.0254}
COLUMNS = ("ref", "x", "y", "rotation", "side", "package", "value")
MOST_ROWS = 200_000
_REQUIRED = ("ref", "x", "y")
USUAL_SPREAD_MM = (15.0, 650.0)
"""Distance of the outermost parts of a usual board along x or y."""

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
}
_UNIT_WORDS = (
    (re.compile(r"\b(millimet(er|re)s?|mm)\b", re.IGNORECASE), "mm"),
    (re.compile(r"\b(mils?|thou)\b", re.IGNORECASE), "mil"),
    (re.compile(r"\b(inch(es)?|in)\b", re.IGNORECASE), "inch"),
    # Units that are recognised to be refused. A single m stands for metres in brackets only.
    (re.compile(r"\b(centimet(er|re)s?|cm)\b", re.IGNORECASE), "cm"),
    (re.compile(r"\b(micromet(er|re)s?|microns?|[uµμ]m)\b", re.IGNORECASE), "um"),
    (re.compile(r"\b(nanomet(er|re)s?|nm)\b", re.IGNORECASE), "nm"),
    (re.compile(r"\b(met(er|re)s?)\b|[(\[]m[)\]]", re.IGNORECASE), "m"),
)
_NUMBER = re.compile(r"^([+-]?(?:\d+[.,]?\d*|[.,]\d+)(?:[eE][+-]?\d+)?)\s*(mm|mils?|inch|in|\"|°|deg)?$")
_REF = re.compile(r"^[A-Za-z*_][\w*.\-/+$]*$")
_SIDES: dict[str, Side] = {
    "top": "top", "t": "top", "f": "top", "front": "top", "toplayer": "top", "fcu": "top", "component": "top",
    "no": "top", "n": "top", "bottom": "bottom", "bot": "bottom", "b": "bottom", "back": "bottom",
    "bottomlayer": "bottom", "bcu": "bottom", "m": "bottom", "solder": "bottom", "yes": "bottom", "y": "bottom",
}  # fmt: skip


@dataclass(frozen=True)
class TableOptions:
    """What the user says about a table; None or empty: recognise it."""

    unit: str | None = None
    columns: tuple[tuple[str, str], ...] = ()
    """Pairs of a name of `COLUMNS` and the header or the number, from 1, of its column."""
    delimiter: str | None = None

    @classmethod
    def parse(cls, units: str | None, columns: str | None, delimiter: str | None) -> TableOptions:
        """Return the options as a person writes them; `columns` is a list such as `ref=1,x=Mid X`."""
        if units is not None and units not in UNITS:
            raise InputError.field("--units", "the unit", units, ", ".join(UNITS))
        named = {"tab": "\t", "space": " ", "spaces": " ", "comma": ",", "semicolon": ";"}
        delimiter = named.get(delimiter, delimiter) if delimiter is not None else None
        if delimiter is not None and len(delimiter) != 1:
            raise InputError.field("--delimiter", "the delimiter", delimiter, "one character, tab or space")
        pairs = []
        for item in columns.split(",") if columns else ():
            column, equals, at = item.partition("=")
            if not equals or column.strip() not in COLUMNS or not at.strip():
                limit = f"NAME=COLUMN with a name of {', '.join(COLUMNS)}"
                raise InputError.field("--columns", "an entry", item, limit)
            pairs.append((column.strip(), at.strip()))
        return cls(units, tuple(pairs), delimiter)


@dataclass(frozen=True)
class _Layout:
    columns: Mapping[str, int]
    first: int
    """Index of the first line with a part."""
    units: Mapping[str, str]
    """Units that the header states for x and y."""
    width: int = 0
    """Number of columns; 0 without a header."""
    headers: tuple[str, ...] = ()

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


def read_placement_table(data: bytes, path: Path, options: TableOptions) -> Design:
    """Read a centroid file."""
    lines = decode(data, path).splitlines()
    if len(lines) > MOST_ROWS:
        raise InputError.field(path, "its number of lines", len(lines), f"at most {MOST_ROWS}")
    delimiter = options.delimiter or _delimiter(lines)
    rows = [_cells(line, delimiter) for line in lines]
    layout = _layout(rows, path, options)
    if delimiter == " ":
        rows = [layout.aligned(row) for row in rows]
    unit, stated = _unit(lines, rows, layout, path, options)
    parts, unplaced = [], []
    for n in range(layout.first, len(rows)):
        if not _is_part(rows[n], layout):
            continue
        if not any(rows[n][layout.columns[name]] for name in ("x", "y")):
            unplaced.append(rows[n][layout.columns["ref"]])
        else:
            parts.append(_part(rows[n], layout, unit, f"{path}, line {n + 1}"))
    if not parts:
        raise InputError(f"{path}: no line has a part with {', '.join(_REQUIRED)}. Name the columns by --columns.")
    shown = ", ".join(f"{name}: column {index + 1}" for name, index in layout.columns.items())
    named = {",": "comma", ";": "semicolon", "\t": "tab", " ": "spaces", "|": "bar"}.get(delimiter, delimiter)
    notes = [f"delimiter {named}; {shown}; unit {unit} ({stated}). Correct it by --columns, --delimiter or --units."]
    if unplaced:
        notes.append(f"{len(unplaced)} parts without x and y were left out: {', '.join(unplaced[:8])}.")
    if "side" not in layout.columns and not any("m" in row for row in rows[layout.first :]):
        notes.append("no column states the side; all parts are taken as those of the top.")
    if "rotation" not in layout.columns:
        notes.append("no column states the rotation; 0° is taken.")
    numbers = tuple((name, index + 1) for name, index in layout.columns.items())
    table = TableReading(named, unit, stated, numbers, layout.headers)
    return Design(path.stem, "centroid", tuple(parts), table=table, notes=tuple(notes))


def _delimiter(lines: Sequence[str]) -> str:
    """Return the delimiter that makes a header of one line, or designator, x and y of most lines."""
    sample = [line for line in lines[:400] if line.strip()]

    def fitness(delimiter: str) -> tuple[int, int]:
        rows = [_cells(line, delimiter) for line in sample]
        header = max((len(found) for row in rows if _has_required(found := _named_columns(row))), default=0)
        return header, sum(map(_is_bare_part, rows))

    return max(("\t", ";", "|", ",", " "), key=fitness)


def _has_required(columns: Mapping[str, int]) -> bool:
    return all(name in columns for name in _REQUIRED)


def _is_bare_part(row: Sequence[str]) -> bool:
    """Return whether a line without a header is designator, x, y and rotation."""
    return len(row) >= 4 and bool(_REF.match(row[0])) and all(_number(c) is not None for c in row[1:4])


def _cells(line: str, delimiter: str) -> list[str]:
    if delimiter == " ":
        return [quoted or plain for quoted, plain in re.findall(r'"([^"]*)"|(\S+)', line)]
    try:
        return [cell.strip() for cell in next(csv.reader([line], delimiter=delimiter), [])]
    except csv.Error:  # a quotation mark within a cell
        return [cell.strip() for cell in line.split(delimiter)]


def _key(cell: str) -> str:
    """Return a header without case, unit and punctuation: `Center-X(mm)` is `centerx`."""
    return re.sub(r"[^a-z]", "", re.sub(r"[\(\[].*?[\)\]]", "", cell.lower()))


def _layout(rows: Sequence[list[str]], path: Path, options: TableOptions) -> _Layout:
    header = -1
    columns: dict[str, int] = {}
    for n, row in enumerate(rows[:200]):
        found = _named_columns(row)
        if _has_required(found):
            header, columns = n, found
            break
    cells = [c for c in rows[header] if c not in ("#", "!", "%")] if header >= 0 else []
    units: dict[str, str] = {
        name: word for name in ("x", "y") if name in columns and (word := _unit_word(cells[columns[name]]))
    }
    for name, at in options.columns:
        columns[name] = _column(path, name, at, cells)
    if header < 0 and not _has_required(columns):
        columns = _without_header(rows, path)
    missing = [name for name in _REQUIRED if name not in columns]
    if missing:
        raise InputError(
            f"{path}: no column is recognised as {', '.join(missing)}. Name it by --columns {missing[0]}=N."
        )
    return _Layout(columns, header + 1, units, len(cells), tuple(cells))


def _named_columns(row: Sequence[str]) -> dict[str, int]:
    cells = [c for c in row if c not in ("#", "!", "%")]  # a header in a comment: `# Ref Val Package …`
    keys = [_key(cell.lstrip("#!% ")) for cell in cells]
    found: dict[str, int] = {}
    for name, words in _NAMES.items():
        # The words are in the order of preference: with "Mid X" and "Ref X" the former is the body's centre.
        for word in words:
            if word in keys and keys.index(word) not in found.values():
                found[name] = keys.index(word)
                break
    return found


def _column(path: Path, name: str, at: str, header: Sequence[str]) -> int:
    if re.fullmatch(r"[0-9]{1,6}", at) and int(at) >= 1:
        return int(at) - 1
    keys = [_key(cell) for cell in header]
    if _key(at) and _key(at) in keys:
        return keys.index(_key(at))
    raise InputError.field(path, f"--columns {name}", at, f"a number from 1, or a header of {list(header)}")


def _without_header(rows: Sequence[list[str]], path: Path) -> dict[str, int]:
    """Return the columns of a table without a header: designator, x, y, rotation, then side or package (Allegro)."""
    usual = [row for row in rows if _is_bare_part(row)]
    if 2 * len(usual) < sum(len(row) > 1 for row in rows) or not usual:
        raise InputError(
            f"{path}: has no header with columns {', '.join(_REQUIRED)}, and its lines are not designator, x, y, "
            "rotation. Name the columns by --columns, for example --columns ref=1,x=3,y=4,rotation=5."
        )
    found = {"ref": 0, "x": 1, "y": 2, "rotation": 3}
    if all(len(row) == 6 and row[4] != "m" for row in usual):  # EAGLE's .mnt
        found |= {"value": 4, "package": 5}
    elif any(len(row) == 5 for row in usual):
        found["package"] = 4
    return found


def _number(cell: str) -> float | None:
    match = _NUMBER.match(cell.strip())
    return number_of(match[1].replace(",", ".")) if match else None


def _required_number(cell: str, name: str, where: str) -> float:
    value = _number(cell)
    if value is None:
        raise InputError.field(where, name, cell, "a number")
    return value


def _unit_word(text: str) -> str | None:
    return next((unit for pattern, unit in _UNIT_WORDS if pattern.search(text)), None)


def _unit(
    lines: Sequence[str], rows: Sequence[list[str]], layout: _Layout, path: Path, options: TableOptions
) -> tuple[str, str]:
    """Return the unit of the table and what states it."""
    if options.unit is not None:
        return options.unit, "as given"
    unit, stated = _stated_unit(lines, rows, layout, path)
    if unit is None:
        return _plausible_unit(rows, layout, path), f"{stated}; the file states none"
    if unit not in UNITS:
        raise InputError(
            f"{path}: states the unit {unit!r} ({stated}), but must be one of {', '.join(UNITS)}.",
            action="Export it in mm, or state the unit of its numbers by --units.",
        )
    return unit, stated


def _stated_unit(
    lines: Sequence[str], rows: Sequence[list[str]], layout: _Layout, path: Path
) -> tuple[str | None, str]:
    """Return the unit that a file states, which may be none of `UNITS`, and what states it."""
    if found := set(layout.units.values()):
        if len(found) > 1:
            raise InputError(
                f"{path}: its header has x in {layout.units['x']} and y in {layout.units['y']}. Give --units."
            )
        return found.pop(), "by the header"
    suffixes = {
        match[2]
        for row in rows[layout.first :]
        if len(row) > layout.columns["x"] and (match := _NUMBER.match(row[layout.columns["x"]])) and match[2]
    }
    if words := {_unit_word(suffix.replace('"', "inch")) for suffix in suffixes} - {None}:
        if len(words) > 1:
            raise InputError(
                f"{path}: its values have different units: {', '.join(sorted(map(str, words)))}. Give --units."
            )
        return str(words.pop()), "by the values"
    for n, line in enumerate(lines[: max(layout.first, 20)]):
        if re.search(r"unit", line, re.IGNORECASE) and (word := _unit_word(line)):
            return word, f"by line {n + 1}"
    return None, "the only one at which the board has a usual size"


def _plausible_unit(rows: Sequence[list[str]], layout: _Layout, path: Path) -> str:
    """Return the only unit at which the parts are spread over a usual board; refuse if there are several or none."""
    spread = []
    for name in ("x", "y"):
        cells = [row[layout.columns[name]] for row in rows[layout.first :] if _is_part(row, layout)]
        values = [v for cell in cells if (v := _number(cell)) is not None]
        spread.append(max(values, default=0.0) - min(values, default=0.0))
    low, high = USUAL_SPREAD_MM
    found = [unit for unit, mm in UNITS.items() if low <= max(spread) * mm <= high]
    if len(found) != 1:
        raise InputError(
            f"{path}: states no unit, and its parts are {max(spread):g} units apart, which is a usual board in "
            f"{' and in '.join(found) or 'no unit'}. Give --units mm, inch or mil."
        )
    return found[0]


def _is_part(row: Sequence[str], layout: _Layout) -> bool:
    needed = max(layout.columns[name] for name in _REQUIRED)
    if len(row) <= needed or not row[layout.columns["ref"]] or row[0].startswith("#"):
        return False
    # Without a header, lines such as `UNITS = MILS` are distinguished from parts by their numbers.
    return bool(layout.width) or all(_number(row[layout.columns[name]]) is not None for name in ("x", "y"))


def _part(row: list[str], layout: _Layout, unit: str, where: str) -> Part:
    """Return the part of a line."""
    # Allegro marks parts of the bottom by an additional cell "m" before the package.
    flipped = "side" not in layout.columns and len(row) > 4 and row[4] == "m"
    if flipped:
        row = [*row[:4], *row[5:]]
    cell = {name: row[at] if at < len(row) else "" for name, at in layout.columns.items()}
    x, y = (_required_number(cell[name], name, where) for name in ("x", "y"))
    turn = _required_number(cell.get("rotation") or "0", "rotation", where)
    side: Side | None = "bottom" if flipped else "top"
    if cell.get("side"):
        side = _SIDES.get(_key(cell["side"]))
        if side is None:
            raise InputError.field(where, "side", cell["side"], "top or bottom")
    assert side is not None
    mm = UNITS[unit]
    package = cell.get("package", "")
    return Part(
        cell["ref"], side, (x * mm, y * mm), normalised(turn), package, cell.get("value", ""), size_from="guess",
        is_mark="fiducial" in package.lower(),
    )  # fmt: skip
