"""Read centroid files: tables of parts with place, rotation and side, as CAD systems and placement machines write them.

Delimiter or width of the columns, decimal comma, units and columns are recognised from the file. What was recognised is
reported, and every item can be given by the user instead. Every line of the file is accounted for. x and y are taken as
seen from the top.
"""

from __future__ import annotations

import math
import re
from collections import Counter
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, replace
from pathlib import Path

from vaoi_station.board_data.design import Design, ImportedColumn, ImportedTable, Part, Side, normalised, noted
from vaoi_station.board_data.readers.table_columns import (
    COLUMNS,
    NOT_THERE,
    REQUIRED,
    TableLayout,
    layout_of,
    rival_designators,
)
from vaoi_station.board_data.readers.table_header import DELIMITER_NAMES, FIXED, HEADER_LINES, Table, find_table
from vaoi_station.board_data.readers.table_lines import Record, split_lines
from vaoi_station.board_data.readers.table_rows import Account, PartRow, part_rows
from vaoi_station.board_data.readers.table_units import UNITS, StatedUnits, stated_units, unit_of
from vaoi_station.board_data.readers.table_words import (
    angle_in,
    are_numbers,
    cells_of_unfitted,
    is_fitted,
    looks_like_part,
    number_in,
    side_in_words,
    sides_of,
)
from vaoi_station.board_data.source_text import decode
from vaoi_station.errors import InputError
from vaoi_station.model.reason import Note

MOST_ROWS = 200_000
MOST_DEGREES = 360.0
_STATES_SIDE = re.compile(r"\b(?:side|seite)\s*[:=]\s*\"?([A-Za-zäöüß]+)", re.IGNORECASE)
_SIDES_OF_SUFFIXES: dict[str, Side] = {".mnt": "top", ".mnb": "bottom"}
"""EAGLE writes one file per side."""
_AFTER_SIDE_IN_NAME = frozenset(("side", "layer", "pos", "pnp", "cpl", "placement", "xy", "centroid", "board"))
"""Words that may follow the side at the end of the name of a file."""
_CLOCKWISE = re.compile(r"(?<![a-z])(?:cw|clockwise|im uhrzeigersinn)(?![a-z])", re.IGNORECASE)
_COUNTER = re.compile(
    r"(?<![a-z])(?:ccw|(?:counter|anti)[\s-]*(?:cw|clockwise)|(?:gegen|entgegen)[a-z ]*uhrzeiger)", re.IGNORECASE
)
_STATES_ROTATION = re.compile(r"^[\s#!;/*]*(?:rotation|angle|orientation|winkel|drehung)s?(?![a-z])", re.IGNORECASE)
_OTHER_ANGLES = re.compile(r"(?<![a-z])(?:gon|gradians?|mdeg)(?![a-z])|1\s*/\s*10+|0[.,]0*1(?![\d])", re.IGNORECASE)
_RADIANS = re.compile(r"(?<![a-z])(rad|radians?)(?![a-z])", re.IGNORECASE)
_BESIDE_TOP, _LEAST_BESIDE, _LEAST_DIFFERENCE, _LEAST_PARTS = 0.25, 0.8, 0.5, 2
"""Parts of the bottom lie beside those of the top if they are within their extent, widened by this share."""


@dataclass(frozen=True)
class TableOptions:
    """What the user says about a table; None or empty: recognise it."""

    unit: str | None = None
    columns: tuple[tuple[str, str], ...] = ()
    """Pairs of a name of `COLUMNS` and the header or the number, from 1, of its column; of `side` also the side, of
    `rotation` also "none"."""
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
    """Read a centroid file.

    Raises:
        InputError: columns or unit are not recognised, or a value of a part is wrong.
    """
    lines = split_lines(decode(data, path))
    if len(lines) > MOST_ROWS:
        raise InputError.field(path, "its number of lines", len(lines), f"at most {MOST_ROWS}")
    table = find_table(lines, options.delimiter)
    layout = layout_of(table, path, options.columns)
    account = Account()
    rows = list(part_rows(table, layout, account, path))
    if not rows:
        raise _without_parts(path, account)
    if 2 * account.merged > len(rows) > 1:
        raise InputError(
            f"{path}: {account.merged} of {len(rows)} lines have more cells than the header.",
            action="If numbers have decimal commas, or values commas, export it with another delimiter.",
        )
    reader = _Reader(path, table, layout, rows, stated_units(table, layout, rows, path, options.unit), account)
    parts = []
    for record, cells in rows:
        if layout.cell(cells, "x") or layout.cell(cells, "y"):
            parts.append(reader.part(record, cells))
        else:
            account.unplaced.append(layout.cell(cells, "ref"))
    if not parts or account.damaged > len(parts):
        raise _without_parts(path, account)
    parts, mirrored = _with_bottom_mirrored_back(parts)
    read_as, *further = _notes(table, reader, account)
    notes = [read_as, _lines_read(account, len(lines), len(parts)), *further, *mirrored]
    columns = [
        ImportedColumn(name=name, number=at + 1, header=layout.headers[at] if at < len(layout.headers) else None)
        for name, at in layout.columns.items()
    ]
    reading = ImportedTable(
        delimiter=DELIMITER_NAMES.get(table.delimiter, table.delimiter),
        unit=reader.units.unit,
        unit_from=reader.units.by,
        columns=columns,
        headers=list(layout.headers),
        all_on=layout.all_on,
    )
    return Design(path.stem, "centroid", tuple(parts), table=reading, notes=tuple(notes))


def _without_parts(path: Path, account: Account) -> InputError:
    if account.left_out:
        some = "; ".join(account.left_out[:4])
        return InputError(
            f"{path}: {len(account.left_out)} lines cannot be read as parts, more than can: {some}.",
            action="Export the table anew, with a delimiter between its cells.",
        )
    return InputError(
        f"{path}: no line has a part with {', '.join(REQUIRED)}.",
        action="Export it with its parts. If it has some, name the columns by --columns.",
    )


def _stated_side(table: Table, path: Path) -> tuple[Side, str]:
    """Return the side of parts that state none, and what states it: the suffix, the head, or the name of the file."""
    if (by_suffix := _SIDES_OF_SUFFIXES.get(path.suffix.lower())) is not None:
        return by_suffix, "by the suffix of the file"
    for record in table.records[:HEADER_LINES]:
        if record.cells == table.headers or looks_like_part(record.cells):
            break
        if (match := _STATES_SIDE.search(record.text)) and (side := side_in_words(match[1])) is not None:
            return side, f"by line {record.line}"
    words = re.findall(r"[A-ZÄÖÜ]?[a-zäöüß]+|[A-ZÄÖÜ]+(?![a-z])", path.stem)
    while words and words[-1].lower() in _AFTER_SIDE_IN_NAME:
        words.pop()
    named = side_in_words(words[-1]) if words else None
    return (named, "by the name of the file") if named is not None else ("top", "")


class _Reader:
    """Makes parts of the lines of one table."""

    def __init__(
        self,
        path: Path,
        table: Table,
        layout: TableLayout,
        rows: Sequence[PartRow],
        units: StatedUnits,
        account: Account,
    ) -> None:
        self._path, self.layout, self.units, self.sections = path, layout, units, account.sections
        self.default_side, self.side_by = _stated_side(table, path)
        if "side" in layout.columns and set(layout.sides.values()) == {"bottom"} and "" not in layout.sides:
            self.default_side = "top"  # a column with one word marks the parts of one side
        header = layout.header_of("rotation")
        comments = (r.text for r in table.records[:HEADER_LINES] if r.line < rows[0][0].line)
        stated = [header, *(text for text in comments if _STATES_ROTATION.search(text))]
        clockwise = (text.strip() for text in stated if _CLOCKWISE.search(text) and not _COUNTER.search(text))
        self.clockwise_by = next(clockwise, "")
        self._in_radians = any(_RADIANS.search(text) for text in stated)
        if (other := _OTHER_ANGLES.search(header)) is not None:
            raise InputError(
                f"{path}: the header {header!r} states rotations in {other[0]!r}, but they must be degrees.",
                action="Export them in degrees.",
            )
        fitted = (layout.cell(cells, "fitted") for _, cells in rows)
        self._unfitted = cells_of_unfitted(fitted, layout.header_of("fitted"))
        self.units_of_values: Counter[str] = Counter()
        self.without_side: list[str] = []
        self.without_rotation: list[str] = []
        self.contradicting: list[str] = []
        """Parts of the top that another column says are mirrored."""
        self.has_sides = "side" in layout.columns or layout.all_on is not None
        self.marks_bottom = bool(account.sections)
        """Whether titles or parts themselves state a side: Allegro's cell "m", EAGLE's `MR90`."""

    def part(self, record: Record, cells: tuple[str, ...]) -> Part:
        """Return the part of a line; raise InputError if a value is not what its column is to hold."""
        layout, where = self.layout, f"{self._path}, line {record.line}"
        # Allegro marks parts of the bottom by an additional cell "m" before the package.
        flipped = not layout.headers and "side" not in layout.columns and cells[4:5] == ("m",)
        if flipped:
            cells = (*cells[:4], *cells[5:])
        ref, package, value, fitted = (layout.cell(cells, name) for name in ("ref", "package", "value", "fitted"))
        unit = cells[layout.unit].lower() if layout.unit is not None else ""
        x, y = (self._length(layout.cell(cells, name), unit, name, where) for name in ("x", "y"))
        mirrored, turn = self._rotation(layout.cell(cells, "rotation"), ref, where)
        self.marks_bottom |= flipped or mirrored
        side = next((side for line, side in self.sections[::-1] if line < record.line), self.default_side)
        if layout.all_on is not None:
            side = layout.all_on
        elif "side" in layout.columns:
            side = self._side(layout.cell(cells, "side"), ref, "bottom" if mirrored else side, where)
        elif flipped or mirrored:
            side = "bottom"
        if layout.mirror is not None and side == "top":
            stated = sides_of([cells[layout.mirror]], layout.headers[layout.mirror])
            self.contradicting += [ref] if "bottom" in stated.values() else []
        used = set(layout.columns.values())
        others = [cell for n, cell in enumerate(cells) if n not in used]
        is_stated_fitted = is_fitted(fitted, layout.header_of("fitted"), others, value)
        return Part(
            ref,
            side,
            (x, y),
            normalised(turn),
            package,
            value,
            size_from="guess",
            fitted=is_stated_fitted and not ("fitted" in layout.columns and fitted.lower() in self._unfitted),
            is_mark="fiducial" in package.lower(),
            line=record.line,
        )

    def _length(self, cell: str, unit: str, name: str, where: str) -> float:
        value = number_in(cell, self.units.decimal)
        if value is None:
            action = f"If the column is not {name}, state another by --columns {name}=N; else write a plain number."
            raise InputError(f"{where}: {name} is {cell!r}, but must be a number.", action=action)
        own = unit_of(cell) or (unit_of(f"1{unit}") if unit else None) or self.units.unit
        if own not in UNITS:
            raise InputError.field(where, name, cell, f"a number in {', '.join(UNITS)}")
        self.units_of_values[own] += 1
        return value * UNITS[own]

    def _rotation(self, cell: str, ref: str, where: str) -> tuple[bool, float]:
        """Return whether EAGLE's `MR90` says that the part is mirrored, and the angle in degrees, seen from the top."""
        if not cell:
            self.without_rotation += [ref] if "rotation" in self.layout.columns else []
            return False, 0.0
        turn = angle_in(cell)
        turn = math.degrees(turn) if self._in_radians and turn is not None else turn
        if turn is None or abs(turn) > MOST_DEGREES:
            raise InputError(
                f"{where}: rotation is {cell!r}, but must be a number from -360 to 360 degrees.",
                action=f"If the column is not the rotation, state another by --columns rotation=N, or {NOT_THERE}.",
            )
        mirrored = cell.strip().upper().startswith(("MR", "SMR"))
        return mirrored, -turn if mirrored or self.clockwise_by else turn

    def _side(self, cell: str, ref: str, default: Side, where: str) -> Side:
        side = self.layout.sides.get(cell) or side_in_words(cell)
        if side is None and not cell:
            self.without_side.append(ref)
            return default
        if side is None:
            raise InputError(
                f"{where}: side is {cell!r}, but must be top or bottom.",
                action="State that of all parts by --columns side=top or side=bottom, or write these words.",
            )
        return side


def _with_bottom_mirrored_back(parts: list[Part]) -> tuple[list[Part], list[Note]]:
    """Return the parts, those of the bottom mirrored back if their x is negated, and what to check.

    KiCad negates x of the bottom on request and leaves the rotations. The parts of the top show it.
    """
    bottom, top = ([part.origin[0] for part in parts if part.side == side] for side in ("bottom", "top"))
    if not bottom or min(bottom) >= 0:
        return parts, []
    if top:
        margin = _BESIDE_TOP * (max(top) - min(top))
        low, high = min(top) - margin, max(top) + margin
        negated, stated = (sum(low <= sign * x <= high for x in bottom) / len(bottom) for sign in (-1, 1))
        enough = min(len(top), len(bottom)) >= _LEAST_PARTS
        if enough and negated >= _LEAST_BESIDE and negated - stated >= _LEAST_DIFFERENCE:
            back = [replace(p, origin=(-p.origin[0], p.origin[1])) if p.side == "bottom" else p for p in parts]
            text = (
                "x of the {count} parts of the bottom is negated: with the other sign they lie beside those of the "
                "top, where they were put. Rotations are taken as they are written."
            )
            return back, [noted("bottom-negated", text, count=len(bottom))]
    if max(bottom) >= 0 or (top and max(top) < 0):
        return parts, []
    text = (
        "x of all parts of the bottom is negative: if the program has negated it, the places are mirrored. Join the "
        "file of the board by --join, or check the board type against a run by vaoi check-board."
    )
    return parts, [noted("bottom-maybe-negated", text)]


def _notes(table: Table, reader: _Reader, account: Account) -> Iterator[Note]:
    layout = reader.layout
    shown = ", ".join(f"{name}: column {index + 1}" for name, index in layout.columns.items())
    unit = " and ".join(sorted(reader.units_of_values)) or reader.units.unit
    how = FIXED if table.delimiter == FIXED else f"delimiter {DELIMITER_NAMES.get(table.delimiter, table.delimiter)}"
    sentence = f"{how}; {shown}; unit {unit} ({reader.units.by}). Correct it by --columns, --delimiter or --units."
    yield Note("table-read-as", sentence, columns=shown, unit=unit)
    if layout.unused:
        yield noted("columns-not-used", "columns that are not used: {names}.", names=", ".join(layout.unused[:12]))
    if rivals := rival_designators(layout, table.rows):
        text = "the designators are those of column {chosen!r}, and not of {others}, which may hold some as well."
        yield noted("designators-chosen", text, chosen=layout.header_of("ref"), others=", ".join(rivals))
    if account.sections and not reader.has_sides:
        shown = ", ".join(f"line {line}: {side}" for line, side in account.sections)
        yield noted("sides-by-titles", "the side of parts is that of the title above them: {titles}.", titles=shown)
    if account.unplaced:
        text = "{count} parts without x and y were left out: {names}."
        yield noted("parts-not-placed", text, count=len(account.unplaced), names=", ".join(account.unplaced[:8]))
    yield from _notes_on_sides(reader)
    if layout.without_rotation:
        yield noted("rotation-assumed", "the rotation is not read, as stated; 0° is taken.")
    elif "rotation" not in layout.columns:
        yield noted("rotation-assumed", "no column states the rotation; 0° is taken.")
    elif refs := reader.without_rotation:
        count, names, header = len(refs), ", ".join(refs[:8]), layout.header_of("rotation")
        sentence = f"{count} parts have no rotation in column {header!r}; 0° is taken: {names}."
        yield Note("rotation-empty", sentence, count=count, names=names)
    if (header := reader.clockwise_by) and "rotation" in layout.columns:
        text = "{header!r} states clockwise rotations; they were made counter-clockwise."
        yield noted("rotation-clockwise", text, header=header)
    if reader.units.is_guess:
        text = f"the file states no unit; {{unit}} is taken, {reader.units.by}. State it by --units."
        yield noted("unit-guessed", text, unit=reader.units.unit)


def _notes_on_sides(reader: _Reader) -> Iterator[Note]:
    layout = reader.layout
    if refs := reader.without_side:
        count, names, header, side = len(refs), ", ".join(refs[:8]), layout.header_of("side"), reader.default_side
        sentence = f"{count} parts have no side in column {header!r}; they are taken as those of the {side}: {names}."
        yield Note("side-empty", sentence, count=count, side=side, names=names)
    if are_numbers(layout.sides) and layout.all_on is None:
        shown = ", ".join(f"{kind} as {side}" for kind, side in sorted(layout.sides.items()) if kind)
        yield noted("sides-by-number", "the side is stated by numbers; they are taken so: {sides}.", sides=shown)
    if reader.contradicting and layout.mirror is not None:
        refs, header = reader.contradicting, layout.headers[layout.mirror]
        text = "column {header!r} says that {count} parts of the top are mirrored; they stay on the top: {names}."
        yield noted("side-contradicted", text, header=header, count=len(refs), names=", ".join(refs[:8]))
    if not reader.has_sides and not reader.marks_bottom:
        by = f", {reader.side_by}" if reader.side_by else ""
        text = (
            f"no column states the side; all parts are taken as those of the {{side}}{by}. State it by --columns "
            "side=bottom, or side=top."
        )
        yield noted("side-assumed", text, side=reader.default_side)


def _lines_read(account: Account, lines: int, parts: int) -> Note:
    counts = {
        "parts": parts,
        "parts without a place": len(account.unplaced),
        "header": account.headers,
        "continued": account.continued,
        "comments, titles and blank lines": account.comments,
        "left out": len(account.left_out),
    }
    said = ", ".join(f"{count} {what}" for what, count in counts.items() if count)
    left = "; ".join(account.left_out[:8])
    left += f"; and {len(account.left_out) - 8} more" if len(account.left_out) > 8 else ""
    sentence = f"{lines} lines read: {said}." + (f" Left out: {left}." if account.left_out else "")
    values = {"lines": lines, "parts": parts, "left_out": len(account.left_out), "names": left}
    return Note("lines-read", sentence, **values)
