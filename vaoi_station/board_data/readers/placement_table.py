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
from dataclasses import dataclass, field, replace
from pathlib import Path

from vaoi_station.board_data.design import Design, Part, Side, TableReading, extent, normalised
from vaoi_station.board_data.readers.table_columns import (
    COLUMNS,
    NOT_THERE,
    REQUIRED,
    TableLayout,
    angle_in,
    columns_by_header,
    columns_without_header,
    doubtful_columns,
    given_columns,
    has_required,
    header_cells,
    is_comment,
    is_fitted,
    is_mirror_header,
    looks_like_part,
    number_in,
    side_of,
)
from vaoi_station.board_data.readers.table_header import DELIMITERS, FIXED, HEADER_LINES, Table, find_table
from vaoi_station.board_data.readers.table_lines import RULER, Record, split_lines
from vaoi_station.board_data.readers.table_units import UNITS, PartRow, StatedUnits, unit_of
from vaoi_station.board_data.source_text import decode
from vaoi_station.errors import InputError
from vaoi_station.model.note import Note

MOST_ROWS = 200_000
MOST_DEGREES = 360.0
_NAMES = {",": "comma", ";": "semicolon", "\t": "tab", " ": "spaces", "|": "bar"}
_STATES_SIDE = re.compile(r"\b(?:side|seite)\s*[:=]\s*\"?([A-Za-zäöüß]+)", re.IGNORECASE)
_SIDES_OF_SUFFIXES: dict[str, Side] = {".mnt": "top", ".mnb": "bottom"}
"""EAGLE writes one file per side."""
_SIDE_IN_NAME: tuple[tuple[Side, re.Pattern[str]], ...] = (
    ("top", re.compile(r"(?:^|[^a-z])(top|front|oben|oberseite|topside)(?:[^a-z]|$)", re.IGNORECASE)),
    ("bottom", re.compile(r"(?:^|[^a-z])(bottom|bot|back|unten|unterseite|bottomside)(?:[^a-z]|$)", re.IGNORECASE)),
)
_CLOCKWISE = re.compile(r"(?<![a-z])(?<!counter)(?<!counter-)(?<!anti)(?<!anti-)(cw|clockwise)(?![a-z])", re.IGNORECASE)
_RADIANS = re.compile(r"(?<![a-z])(rad|radians?)(?![a-z])", re.IGNORECASE)


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


@dataclass
class _Account:
    """What became of every line."""

    comments: int = 0
    """Comments, titles, rulers and blank lines."""
    headers: int = 0
    continued: int = 0
    """Lines after the first one of a record."""
    unplaced: list[str] = field(default_factory=list)
    left_out: list[str] = field(default_factory=list)
    """What each line seems to hold."""


def read_placement_table(data: bytes, path: Path, options: TableOptions) -> Design:
    """Read a centroid file.

    Raises:
        InputError: columns or unit are not recognised, or a value of a part is wrong.
    """
    lines = split_lines(decode(data, path))
    if len(lines) > MOST_ROWS:
        raise InputError.field(path, "its number of lines", len(lines), f"at most {MOST_ROWS}")
    table = find_table(lines, options.delimiter)
    layout = _layout(table, path, options)
    account = _Account()
    rows = list(_part_rows(table, layout, account))
    if not rows:
        raise _without_parts(path, account)
    reader = _Reader(
        path, layout, rows, StatedUnits.of(table, layout, rows, path, options.unit), _stated_side(table, path)
    )
    parts = []
    for record, cells in rows:
        if not any(cells[layout.columns[name]] for name in ("x", "y")):
            account.unplaced.append(cells[layout.columns["ref"]])
        else:
            parts.append(reader.part(record, cells))
    if not parts or len(account.left_out) > len(parts):
        raise _without_parts(path, account)
    parts, mirrored = _with_bottom_mirrored_back(parts)
    notes = [*_notes(table, layout, reader, account, len(lines), len(parts)), *mirrored]
    columns = tuple((name, index + 1) for name, index in layout.columns.items())
    named = _NAMES.get(table.delimiter, table.delimiter)
    reading = TableReading(named, reader.units.unit, reader.units.by, columns, layout.headers, layout.all_on)
    return Design(path.stem, "centroid", tuple(parts), table=reading, notes=tuple(notes))


def _without_parts(path: Path, account: _Account) -> InputError:
    if account.left_out:
        some = "; ".join(account.left_out[:4])
        return InputError(
            f"{path}: {len(account.left_out)} lines cannot be read as parts, more than can: {some}.",
            action="Correct these lines, or state delimiter and columns by --delimiter and --columns.",
        )
    return InputError(
        f"{path}: no line has a part with {', '.join(REQUIRED)}.",
        action="Export it with its parts. If it has some, name the columns by --columns.",
    )


# The columns.


def _layout(table: Table, path: Path, options: TableOptions) -> TableLayout:
    """Return what the columns hold; refuse a header that leaves open where place, rotation or side stand.

    Raises:
        InputError: a column is not recognised.
    """
    rows, headers = table.rows(), table.headers
    most = max([len(headers), *map(len, rows)], default=0)
    if not rows:
        most = max((len(record.cells) for record in table.records), default=0)
    given, all_on, without_rotation = given_columns(path, options.columns, headers, most)
    columns = dict(given)
    if table.header is not None:
        found = columns_by_header(headers, rows)
    else:
        found = columns_without_header(rows) or {} if not has_required(columns) else {}
    for name, at in found.items():
        hidden = (name == "side" and all_on is not None) or (name == "rotation" and without_rotation)
        if not hidden and name not in columns and at not in given.values():
            columns[name] = at
    missing = [name for name in REQUIRED if name not in columns]
    if missing:
        raise _not_recognised(path, table, missing)
    order = {name: columns[name] for name in COLUMNS if name in columns}
    free = [n for n in range(most) if n not in order.values()]
    unused = tuple(headers[n] if n < len(headers) and headers[n] else str(n + 1) for n in free)
    layout = TableLayout(
        order, -1 if table.header is None else table.header, 0 if table.header is None else table.header + 1, all_on,
        headers, without_rotation, unused,
    )  # fmt: skip
    layout = replace(layout, marks_mirrored=is_mirror_header(layout.header_of("side")))
    if table.header is not None:
        _refuse_doubtful(path, layout, rows)
    return layout


def _refuse_doubtful(path: Path, layout: TableLayout, rows: Sequence[Sequence[str]]) -> None:
    for role, columns in doubtful_columns(layout, rows).items():
        shown = ", ".join(repr(layout.headers[n]) if n < len(layout.headers) else str(n + 1) for n in columns)
        other = "side=top, or side=bottom, for all parts" if role == "side" else f"rotation={NOT_THERE}"
        raise InputError(
            f"{path}: no column is recognised as the {role}, but it may be {shown}.",
            action=f"State it by --columns {role}={columns[0] + 1}; if it is not the {role}, by --columns {other}.",
        )


def _not_recognised(path: Path, table: Table, missing: Sequence[str]) -> InputError:
    entries = ",".join(f"{name}=N" for name in missing)
    if table.header is not None:
        line = table.records[table.header].line
        return InputError(
            f"{path}, line {line}: the header {list(table.headers)} has no column that is recognised as "
            f"{', '.join(missing)}.",
            action=f"Name the columns by their numbers from 1 or their headers: --columns {entries}.",
        )
    return InputError(
        f"{path}: has no header with columns {', '.join(REQUIRED)}, and its lines are not designator, x, y, rotation.",
        action="Name the columns by --columns, for example --columns ref=1,x=3,y=4,rotation=5.",
    )


def _part_rows(table: Table, layout: TableLayout, account: _Account) -> Iterator[PartRow]:
    """Yield the records with a part, their cells in the columns of the layout; account for all others."""
    width = table.usual_width()
    seen_part = False
    for n, record in enumerate(table.records):
        account.continued += record.lines - 1
        text = record.text.strip()
        if n == table.header or (table.header is not None and tuple(header_cells(record.cells)) == table.headers):
            account.headers += 1
        elif not text or RULER.match(record.text) or n < layout.first:
            account.comments += 1
        elif is_comment(record.cells):
            cells = tuple(header_cells(record.cells))
            if len(cells) == width and looks_like_part(cells):
                account.left_out.append(f"line {record.line} is a comment that holds {cells[layout.columns['ref']]!r}")
            else:
                account.comments += 1
        else:
            aligned = _aligned(record, width, layout, table.delimiter == " ")
            if aligned is not None and _is_part(aligned, layout):
                seen_part = True
                yield record, aligned
            elif not seen_part and not _may_hold_part(record.cells):
                account.comments += 1
            else:
                account.left_out.append(_described(record, width, layout))


def _may_hold_part(cells: Sequence[str]) -> bool:
    """Return whether a line before the first part may be a damaged part: a designator and a number."""
    is_named = any(re.match(r"[A-Za-z]{1,4}\d+$", cell) for cell in cells)
    return is_named and any(number_in(cell) is not None for cell in cells)


def _aligned(record: Record, width: int, layout: TableLayout, is_spaced: bool) -> tuple[str, ...] | None:
    """Return the cells of a record in the columns of the header; None if that is not possible in one way only.

    An unquoted value with the delimiter in it makes more cells; in a table of words, an empty value makes fewer.
    """
    cells = record.cells
    if record.cut:
        return None
    while len(cells) > max(width, 1) and not cells[-1]:
        cells = cells[:-1]
    surplus = len(cells) - width
    if surplus == 0 or not layout.headers:
        return cells if len(cells) > layout.last else None
    numeric = {layout.columns[name] for name in ("x", "y", "rotation", "side", "ref") if name in layout.columns}
    texts = [n for n in range(width) if n not in numeric]
    if surplus > 0:
        tries = [(*cells[:n], " ".join(cells[n : n + surplus + 1]), *cells[n + surplus + 1 :]) for n in texts]
    elif is_spaced and surplus >= -2:
        tries = [(*cells[:n], *[""] * -surplus, *cells[n:]) for n in texts if n <= len(cells)]
    else:
        used = [n for n in layout.columns.values() if n >= len(cells)]
        return None if used or len(cells) <= layout.last else (*cells, *[""] * -surplus)
    valid = [found for found in tries if _is_valid(found, layout)]
    kinds = {tuple(found[n] for n in sorted(numeric)) for found in valid}
    return valid[0] if len(kinds) == 1 else None


def _is_valid(cells: Sequence[str], layout: TableLayout) -> bool:
    """Return whether the cells of a line are what its columns are to hold."""
    columns = layout.columns
    if any(number_in(cells[columns[name]]) is None for name in ("x", "y")):
        return False
    if "rotation" in columns and angle_in(cells[columns["rotation"]] or "0") is None:
        return False
    return "side" not in columns or side_of(cells[columns["side"]] or "top", layout.marks_mirrored) is not None


def _is_part(cells: Sequence[str], layout: TableLayout) -> bool:
    """Return whether the cells of a line are those of a part, perhaps with a wrong value."""
    ref = cells[layout.columns["ref"]]
    x, y = (cells[layout.columns[name]] for name in ("x", "y"))
    if not ref or (not layout.headers and (number_in(x) is None or number_in(y) is None)):
        return False
    return (
        (not x and not y)
        or number_in(x) is not None
        or number_in(y) is not None
        or re.match(r"[A-Za-z]+\d+$", ref) is not None
    )


def _described(record: Record, width: int, layout: TableLayout) -> str:
    """Return what a line that cannot be read seems to hold."""
    at = f"line {record.line}"
    shown = record.text.strip()[:40]
    if record.cut:
        return f"{at} has words across the columns: {shown!r}"
    for delimiter in DELIMITERS:
        if len(record.cells) < 3 and record.text.count(delimiter) >= 2:
            return f"{at} seems to have another delimiter, {_NAMES[delimiter]}: {shown!r}"
    ref_at = layout.columns["ref"]
    ref = record.cells[ref_at] if ref_at < len(record.cells) else ""
    what = f", it seems to be part {ref}" if re.match(r"[A-Za-z]+\d", ref) else f": {shown!r}"
    if len(record.cells) != width:
        return f"{at} has {len(record.cells)} of {width} cells{what}"
    return f"{at} has no designator or no place{what}"


# Parts.


def _stated_side(table: Table, path: Path) -> tuple[Side, str]:
    """Return the side of parts that state none, and what states it: the suffix, the head, or the name of the file."""
    if (by_suffix := _SIDES_OF_SUFFIXES.get(path.suffix.lower())) is not None:
        return by_suffix, "by the suffix of the file"
    for record in table.records[:HEADER_LINES]:
        if record.cells == table.headers or looks_like_part(record.cells):
            break
        if (match := _STATES_SIDE.search(record.text)) and (
            side := side_of(match[1], marks_mirrored=False)
        ) is not None:
            return side, f"by line {record.line}"
    named = [side for side, pattern in _SIDE_IN_NAME if pattern.search(path.stem)]
    return (named[0], "by the name of the file") if len(named) == 1 else ("top", "")


class _Reader:
    """Makes parts of the lines of one table."""

    def __init__(
        self,
        path: Path,
        layout: TableLayout,
        rows: Sequence[PartRow],
        units: StatedUnits,
        side: tuple[Side, str],
    ) -> None:
        self._path, self._layout, self.units = path, layout, units
        self.default_side, self.side_by = side
        self._side_numbers = frozenset(cell for _, cells in rows if (cell := self._cell(cells, "side")).isdigit())
        header = layout.header_of("rotation")
        self.is_clockwise = _CLOCKWISE.search(header) is not None
        self._in_radians = _RADIANS.search(header) is not None
        self.units_of_values: Counter[str] = Counter()
        self.without_side: list[str] = []
        self.without_rotation: list[str] = []
        self.marks_bottom = False
        """Whether parts themselves say that they lie on the bottom: Allegro's cell "m", EAGLE's `MR90`."""

    def _cell(self, cells: Sequence[str], name: str) -> str:
        at = self._layout.columns.get(name)
        return cells[at] if at is not None and at < len(cells) else ""

    def part(self, record: Record, cells: tuple[str, ...]) -> Part:
        """Return the part of a line.

        Raises:
            InputError: a value is not what its column is to hold.
        """
        where = f"{self._path}, line {record.line}"
        # Allegro marks parts of the bottom by an additional cell "m" before the package.
        flipped = not self._layout.headers and len(cells) > 4 and cells[4] == "m"
        if flipped:
            cells = (*cells[:4], *cells[5:])
        ref, package, value = (self._cell(cells, name) for name in ("ref", "package", "value"))
        x, y = (self._length(self._cell(cells, name), name, where) for name in ("x", "y"))
        mirrored, turn = self._rotation(self._cell(cells, "rotation"), ref, where)
        self.marks_bottom |= flipped or mirrored
        side: Side = "bottom" if flipped or mirrored else self.default_side
        if self._layout.all_on is not None:
            side = self._layout.all_on
        elif "side" in self._layout.columns:
            side = self._side(self._cell(cells, "side"), ref, side, where)
        used = set(self._layout.columns.values())
        others = [cell for n, cell in enumerate(cells) if n not in used]
        return Part(
            ref, side, (x, y), normalised(turn), package, value, size_from="guess",
            fitted=is_fitted(self._cell(cells, "fitted"), self._layout.header_of("fitted"), (value, *others)),
            is_mark="fiducial" in package.lower(), line=record.line,
        )  # fmt: skip

    def _length(self, cell: str, name: str, where: str) -> float:
        value = number_in(cell, self.units.decimal)
        if value is None:
            raise InputError.field(where, name, cell, "a number")
        own = unit_of(cell)
        if own is not None and own not in UNITS:
            raise InputError.field(where, name, cell, f"a number in {', '.join(UNITS)}")
        self.units_of_values[own or self.units.unit] += 1
        return value * UNITS[own or self.units.unit]

    def _rotation(self, cell: str, ref: str, where: str) -> tuple[bool, float]:
        """Return whether EAGLE's `MR90` says that the part is mirrored, and the angle in degrees, seen from the top."""
        if "rotation" not in self._layout.columns:
            return False, 0.0
        if not cell:
            self.without_rotation.append(ref)
            return False, 0.0
        turn = angle_in(cell)
        if turn is None:
            raise InputError.field(where, "rotation", cell, "a number of degrees")
        turn = math.degrees(turn) if self._in_radians else turn
        if abs(turn) > MOST_DEGREES:
            raise InputError(
                f"{where}: rotation is {cell!r}, but must be from -360 to 360 degrees.",
                action=f"If the column is not the rotation, state another by --columns rotation=N, or {NOT_THERE}.",
            )
        mirrored = cell.lstrip().startswith(("M", "SM"))
        return mirrored, -turn if mirrored or self.is_clockwise else turn

    def _side(self, cell: str, ref: str, default: Side, where: str) -> Side:
        if not cell and not self._layout.marks_mirrored:
            self.without_side.append(ref)
            return default
        side = side_of(cell, self._layout.marks_mirrored, self._side_numbers)
        if side is None:
            raise InputError(
                f"{where}: side is {cell!r}, but must be top or bottom.",
                action="If the column is not the side, state another by --columns side=N, or side=top for all parts.",
            )
        return side


def _with_bottom_mirrored_back(parts: list[Part]) -> tuple[list[Part], list[Note]]:
    """Return the parts, those of the bottom mirrored back if their x is negated, and what to check.

    KiCad negates x of the bottom on request and leaves the rotations. The parts of the top show it.
    """
    bottom = [part for part in parts if part.side == "bottom"]
    top = [part for part in parts if part.side == "top"]
    if len(bottom) < 2 or max(part.origin[0] for part in bottom) >= 0:
        return parts, []
    if not top:
        sentence = (
            "x of all parts of the bottom is negative: if the program has negated it, the places are mirrored. Join "
            "the file of the board by --join, or check the board type against a run by vaoi check-board."
        )
        return parts, [Note("bottom-maybe-negated", sentence)]
    (low, _), (high, _) = extent([part.origin for part in top])
    (left, _), (right, _) = extent([(-part.origin[0], part.origin[1]) for part in bottom])
    width = max(high - low, 1e-9)
    beside = low >= 0 and left >= low - 0.25 * width and right <= high + 0.25 * width
    if not beside:
        return parts, []
    back = [replace(p, origin=(-p.origin[0], p.origin[1])) if p.side == "bottom" else p for p in parts]
    sentence = (
        f"x of all {len(bottom)} parts of the bottom is negated, and they lie beside those of the top; it was made "
        "positive. Rotations are taken as they are written."
    )
    return back, [Note("bottom-negated", sentence, count=len(bottom))]


# What is said about the reading.


def _notes(
    table: Table, layout: TableLayout, reader: _Reader, account: _Account, lines: int, parts: int
) -> Iterator[Note]:
    shown = ", ".join(f"{name}: column {index + 1}" for name, index in layout.columns.items())
    units = reader.units_of_values
    unit = " and ".join(sorted(units)) if len(units) > 1 else next(iter(units), reader.units.unit)
    how = FIXED if table.delimiter == FIXED else f"delimiter {_NAMES.get(table.delimiter, table.delimiter)}"
    sentence = f"{how}; {shown}; unit {unit} ({reader.units.by}). Correct it by --columns, --delimiter or --units."
    yield Note("table-read-as", sentence, columns=shown, unit=unit)
    yield _lines_read(account, lines, parts)
    if layout.unused:
        names = ", ".join(layout.unused[:12])
        yield Note("columns-not-used", f"columns that are not used: {names}.", names=names)
    if account.unplaced:
        names = ", ".join(account.unplaced[:8])
        sentence = f"{len(account.unplaced)} parts without x and y were left out: {names}."
        yield Note("parts-not-placed", sentence, count=len(account.unplaced), names=names)
    yield from _notes_on_sides(layout, reader)
    if layout.without_rotation:
        yield Note("rotation-assumed", "the rotation is not read, as stated; 0° is taken.")
    elif "rotation" not in layout.columns:
        yield Note("rotation-assumed", "no column states the rotation; 0° is taken.")
    elif reader.without_rotation:
        count, names = len(reader.without_rotation), ", ".join(reader.without_rotation[:8])
        sentence = f"{count} parts have no rotation in column {layout.header_of('rotation')!r}; 0° is taken: {names}."
        yield Note("rotation-empty", sentence, count=count, names=names)
    if reader.is_clockwise:
        header = layout.header_of("rotation")
        sentence = f"the header {header!r} states clockwise rotations; they were made counter-clockwise."
        yield Note("rotation-clockwise", sentence, header=header)


def _notes_on_sides(layout: TableLayout, reader: _Reader) -> Iterator[Note]:
    if reader.without_side:
        count, names, side = len(reader.without_side), ", ".join(reader.without_side[:8]), reader.default_side
        sentence = (
            f"{count} parts have no side in column {layout.header_of('side')!r}; they are taken as those of the "
            f"{side}: {names}."
        )
        yield Note("side-empty", sentence, count=count, side=side, names=names)
    if "side" not in layout.columns and layout.all_on is None and not reader.marks_bottom:
        side = reader.default_side
        by = f", {reader.side_by}" if reader.side_by else ""
        sentence = (
            f"no column states the side; all parts are taken as those of the {side}{by}. State it by --columns "
            "side=bottom, or side=top."
        )
        yield Note("side-assumed", sentence, side=side)


def _lines_read(account: _Account, lines: int, parts: int) -> Note:
    """Return the account of all lines."""
    counts = [
        (parts, "parts"), (len(account.unplaced), "parts without a place"), (account.headers, "header"),
        (account.continued, "continued"), (account.comments, "comments, titles and blank lines"),
        (len(account.left_out), "left out"),
    ]  # fmt: skip
    said = ", ".join(f"{count} {what}" for count, what in counts if count)
    left = "; ".join(account.left_out[:8])
    more = f"; and {len(account.left_out) - 8} more" if len(account.left_out) > 8 else ""
    sentence = f"{lines} lines read: {said}." + (f" Left out: {left}{more}." if account.left_out else "")
    values = {"lines": lines, "parts": parts, "left_out": len(account.left_out), "names": f"{left}{more}"}
    return Note("lines-read", sentence, **values)
