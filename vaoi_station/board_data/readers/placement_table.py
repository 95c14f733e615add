"""Read centroid files: tables of parts with place, rotation and side, as CAD systems and placement machines write them.

Delimiter, decimal comma, unit and columns are recognised from the file. What was recognised is reported, and every item
can be given by the user instead. x and y are taken as seen from the top.
"""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from vaoi_station.board_data.design import Design, Part, Side, TableReading, normalised
from vaoi_station.board_data.readers.table_columns import (
    COLUMNS,
    NUMBER,
    REQUIRED,
    TableLayout,
    cells_of,
    find_delimiter,
    find_layout,
    is_fitted,
    number_in,
    plain_key,
)
from vaoi_station.board_data.source_text import decode
from vaoi_station.errors import InputError
from vaoi_station.model.note import Note

UNITS = {"mm": 1.0, "inch": 25.4, "mil": 0.0254}
MOST_ROWS = 200_000
USUAL_SPREAD_MM = (15.0, 650.0)
"""Distance of the outermost parts of a usual board along x or y."""

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
_SIDES: dict[str, Side] = {
    "top": "top", "t": "top", "f": "top", "front": "top", "toplayer": "top", "fcu": "top", "component": "top",
    "no": "top", "n": "top", "bottom": "bottom", "bot": "bottom", "b": "bottom", "back": "bottom",
    "bottomlayer": "bottom", "bcu": "bottom", "m": "bottom", "solder": "bottom", "yes": "bottom", "y": "bottom",
}  # fmt: skip
_SIDES_OF_SUFFIXES: dict[str, Side] = {".mnt": "top", ".mnb": "bottom"}
"""EAGLE writes one file per side."""


@dataclass(frozen=True)
class TableOptions:
    """What the user says about a table; None or empty: recognise it."""

    unit: str | None = None
    columns: tuple[tuple[str, str], ...] = ()
    """Pairs of a name of `COLUMNS` and the header or the number, from 1, of its column; of `side` also the side."""
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


def read_placement_table(data: bytes, path: Path, options: TableOptions) -> Design:
    """Read a centroid file."""
    lines = decode(data, path).splitlines()
    if len(lines) > MOST_ROWS:
        raise InputError.field(path, "its number of lines", len(lines), f"at most {MOST_ROWS}")
    delimiter = options.delimiter or find_delimiter(lines)
    rows = [cells_of(line, delimiter) for line in lines]
    layout = find_layout(rows, path, options.columns)
    stated_side = layout.all_on
    layout = replace(layout, all_on=stated_side or _SIDES_OF_SUFFIXES.get(path.suffix.lower()))
    if delimiter == " ":
        rows = [layout.aligned(row) for row in rows]
    part_lines = [n for n in range(layout.first, len(rows)) if _is_part(rows[n], layout)]
    if not part_lines:
        raise _without_parts(path)
    unit, stated = _unit(lines, rows, layout, path, options)
    parts, unplaced = [], []
    for n in part_lines:
        if not any(rows[n][layout.columns[name]] for name in ("x", "y")):
            unplaced.append(rows[n][layout.columns["ref"]])
        else:
            parts.append(replace(_part(rows[n], layout, unit, f"{path}, line {n + 1}"), line=n + 1))
    if not parts:
        raise _without_parts(path)
    shown = ", ".join(f"{name}: column {index + 1}" for name, index in layout.columns.items())
    named = {",": "comma", ";": "semicolon", "\t": "tab", " ": "spaces", "|": "bar"}.get(delimiter, delimiter)
    sentence = f"delimiter {named}; {shown}; unit {unit} ({stated}). Correct it by --columns, --delimiter or --units."
    notes = [Note("table-read-as", sentence, columns=shown, unit=unit)]
    if unplaced:
        names = ", ".join(unplaced[:8])
        sentence = f"{len(unplaced)} parts without x and y were left out: {names}."
        notes.append(Note("parts-not-placed", sentence, count=len(unplaced), names=names))
    if "side" not in layout.columns and not stated_side and not any("m" in row for row in rows[layout.first :]):
        taken = f"all parts are taken as those of the {layout.all_on or 'top'}"
        sentence = f"no column states the side; {taken}. State it by --columns side=bottom, or side=top."
        notes.append(Note("side-assumed", sentence, side=layout.all_on or "top"))
    if "rotation" not in layout.columns:
        notes.append(Note("rotation-assumed", "no column states the rotation; 0° is taken."))
    numbers = tuple((name, index + 1) for name, index in layout.columns.items())
    table = TableReading(named, unit, stated, numbers, layout.headers, stated_side)
    return Design(path.stem, "centroid", tuple(parts), table=table, notes=tuple(notes))


def _without_parts(path: Path) -> InputError:
    return InputError(f"{path}: no line has a part with {', '.join(REQUIRED)}. Name the columns by --columns.")


def _required_number(cell: str, name: str, where: str) -> float:
    value = number_in(cell)
    if value is None:
        raise InputError.field(where, name, cell, "a number")
    return value


def _unit_word(text: str) -> str | None:
    return next((unit for pattern, unit in _UNIT_WORDS if pattern.search(text)), None)


def _unit(
    lines: Sequence[str], rows: Sequence[list[str]], layout: TableLayout, path: Path, options: TableOptions
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
    lines: Sequence[str], rows: Sequence[list[str]], layout: TableLayout, path: Path
) -> tuple[str | None, str]:
    """Return the unit that a file states, which may be none of `UNITS`, and what states it."""
    x, y = (_unit_word(layout.header_of(name)) for name in ("x", "y"))
    if x and y and x != y:
        raise InputError(f"{path}: its header has x in {x} and y in {y}. Give --units.")
    if x or y:
        return x or y, "by the header"
    suffixes = {
        match[2]
        for row in rows[layout.first :]
        if len(row) > layout.columns["x"] and (match := NUMBER.match(row[layout.columns["x"]])) and match[2]
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


def _plausible_unit(rows: Sequence[list[str]], layout: TableLayout, path: Path) -> str:
    """Return the only unit at which the parts are spread over a usual board; refuse if there are several or none."""
    spread = []
    for name in ("x", "y"):
        cells = [row[layout.columns[name]] for row in rows[layout.first :] if _is_part(row, layout)]
        values = [v for cell in cells if (v := number_in(cell)) is not None]
        spread.append(max(values, default=0.0) - min(values, default=0.0))
    low, high = USUAL_SPREAD_MM
    found = [unit for unit, mm in UNITS.items() if low <= max(spread) * mm <= high]
    if len(found) != 1:
        raise InputError(
            f"{path}: states no unit, and its parts are {max(spread):g} units apart, which is a usual board in "
            f"{' and in '.join(found) or 'no unit'}. Give --units mm, inch or mil."
        )
    return found[0]


def _is_part(row: Sequence[str], layout: TableLayout) -> bool:
    needed = max(layout.columns[name] for name in REQUIRED)
    if len(row) <= needed or not row[layout.columns["ref"]] or row[0].startswith("#"):
        return False
    # Without a header, lines such as `UNITS = MILS` are distinguished from parts by their numbers.
    return bool(layout.width) or all(number_in(row[layout.columns[name]]) is not None for name in ("x", "y"))


def _part(row: list[str], layout: TableLayout, unit: str, where: str) -> Part:
    """Return the part of a line."""
    # Allegro marks parts of the bottom by an additional cell "m" before the package.
    flipped = "side" not in layout.columns and len(row) > 4 and row[4] == "m"
    if flipped:
        row = [*row[:4], *row[5:]]
    cell = {name: row[at] if at < len(row) else "" for name, at in layout.columns.items()}
    x, y = (_required_number(cell[name], name, where) for name in ("x", "y"))
    turn = _required_number(cell.get("rotation") or "0", "rotation", where)
    side: Side | None = layout.all_on or ("bottom" if flipped else "top")
    if cell.get("side"):
        side = _SIDES.get(plain_key(cell["side"]))
        if side is None:
            raise InputError.field(where, "side", cell["side"], "top or bottom")
    assert side is not None
    mm = UNITS[unit]
    package, value = cell.get("package", ""), cell.get("value", "")
    return Part(
        cell["ref"], side, (x * mm, y * mm), normalised(turn), package, value, size_from="guess",
        fitted=is_fitted(cell.get("fitted", ""), layout.header_of("fitted"), value),
        is_mark="fiducial" in package.lower(),
    )  # fmt: skip
