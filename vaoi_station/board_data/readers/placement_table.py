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

from vaoi_station.board_data.design import Design, Part, Side, TableReading, normalised
from vaoi_station.board_data.readers.table_columns import (
    COLUMNS,
    NOT_THERE,
    REQUIRED,
    TableLayout,
    angle_in,
    are_numbers,
    columns_by_header,
    columns_without_header,
    doubtful_columns,
    given_columns,
    has_required,
    is_fitted,
    letters_of_unfitted,
    looks_like_part,
    marks_only_fitted,
    mirror_column,
    number_in,
    repeated_columns,
    rival_designators,
    side_in_words,
    sides_of,
    unit_column,
)
from vaoi_station.board_data.readers.table_header import FIXED, HEADER_LINES, Table, find_table
from vaoi_station.board_data.readers.table_lines import Record, split_lines
from vaoi_station.board_data.readers.table_rows import DELIMITER_NAMES, Account, PartRow, part_rows
from vaoi_station.board_data.readers.table_units import UNITS, StatedUnits, unit_of
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
_BESIDE_TOP, _LEAST_BESIDE, _LEAST_DIFFERENCE, _LEAST_PARTS = 0.25, 0.8, 0.5, 2
"""Parts of the bottom lie beside those of the top if they are within their extent, widened by this share."""
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
    account = Account()
    rows = list(part_rows(table, layout, account, path))
    if not rows:
        raise _without_parts(path, account)
    if 2 * account.merged > len(rows) > 1:
        raise InputError(
            f"{path}: {account.merged} of {len(rows)} lines have more cells than the header.",
            action="If numbers have decimal commas, or values commas, export it with another delimiter.",
        )
    reader = _Reader(path, table, layout, rows, StatedUnits.of(table, layout, rows, path, options.unit), account)
    parts = []
    for record, cells in rows:
        if not any(cells[layout.columns[name]] for name in ("x", "y")):
            account.unplaced.append(cells[layout.columns["ref"]])
        else:
            parts.append(reader.part(record, cells))
    if not parts or account.damaged > len(parts):
        raise _without_parts(path, account)
    parts, mirrored = _with_bottom_mirrored_back(parts)
    notes = [*_notes(table, layout, reader, account, len(lines), len(parts)), *mirrored]
    columns = tuple((name, index + 1) for name, index in layout.columns.items())
    named = DELIMITER_NAMES.get(table.delimiter, table.delimiter)
    reading = TableReading(named, reader.units.unit, reader.units.by, columns, layout.headers, layout.all_on)
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


# The columns.


def _layout(table: Table, path: Path, options: TableOptions) -> TableLayout:
    """Return what the columns hold; refuse a header that leaves open where place, rotation or side stand.

    Raises:
        InputError: a column is not recognised.
    """
    rows, headers = table.rows, table.headers
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
    if len({columns[name] for name in REQUIRED}) < len(REQUIRED):
        written = ",".join(f"{name}={columns[name] + 1}" for name in REQUIRED)
        raise InputError.field(path, "--columns", written, "three different columns for ref, x and y")
    order = {name: columns[name] for name in COLUMNS if name in columns}
    free = [n for n in range(most) if n not in order.values()]
    unused = tuple(headers[n] if n < len(headers) and headers[n] else str(n + 1) for n in free)
    header = -1 if table.header is None else table.header
    layout = TableLayout(order, header, header + 1, all_on, headers, without_rotation, unused)
    side = order.get("side")
    values = [row[side] for row in rows if side is not None and side < len(row)]
    sides = sides_of([*values, ""], layout.header_of("side") if headers else "mirror" if "m" in values else "")
    layout = replace(layout, sides=sides, unit=unit_column(headers), mirror=mirror_column(headers, order))
    if table.header is not None or given:
        _refuse_doubtful(path, layout, rows)
    twice = repeated_columns(headers, order) if table.header is not None else []
    if twice and not all(name in given for name in REQUIRED):
        raise InputError(
            f"{path}: its header names the columns of {' and '.join(twice)} twice, as of tables side by side.",
            action="Import each table from a file of its own, or name its columns by --columns ref=N,x=N,y=N.",
        )
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


# Parts.


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
        self._path, self._layout, self.units, self._sections = path, layout, units, account.sections
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
        fitted = [self._cell(cells, "fitted") for _, cells in rows]
        self._marks_fitted = marks_only_fitted(fitted, layout.header_of("fitted"))
        self._unfitted_letters = letters_of_unfitted(fitted)
        self.units_of_values: Counter[str] = Counter()
        self.without_side: list[str] = []
        self.without_rotation: list[str] = []
        self.contradicting: list[str] = []
        """Parts of the top that another column says are mirrored."""
        self.has_sides = "side" in layout.columns or layout.all_on is not None
        self.marks_bottom = bool(account.sections)
        """Whether titles or parts themselves state a side: Allegro's cell "m", EAGLE's `MR90`."""

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
        flipped = not self._layout.headers and "side" not in self._layout.columns and cells[4:5] == ("m",)
        if flipped:
            cells = (*cells[:4], *cells[5:])
        ref, package, value = (self._cell(cells, name) for name in ("ref", "package", "value"))
        unit = cells[self._layout.unit].lower() if self._layout.unit is not None else ""
        x, y = (self._length(self._cell(cells, name), unit, name, where) for name in ("x", "y"))
        mirrored, turn = self._rotation(self._cell(cells, "rotation"), ref, where)
        self.marks_bottom |= flipped or mirrored
        side = next((side for line, side in self._sections[::-1] if line < record.line), self.default_side)
        if flipped or mirrored:
            side = "bottom"
        if self._layout.all_on is not None:
            side = self._layout.all_on
        elif "side" in self._layout.columns:
            side = self._side(self._cell(cells, "side"), ref, side, where)
        if self._layout.mirror is not None and side == "top":
            stated = sides_of([cells[self._layout.mirror]], self._layout.headers[self._layout.mirror])
            self.contradicting += [ref] if "bottom" in stated.values() else []
        used = set(self._layout.columns.values())
        others = [cell for n, cell in enumerate(cells) if n not in used]
        fitted = self._cell(cells, "fitted")
        unmarked = (self._marks_fitted and fitted in ("", "-")) or fitted.lower() in self._unfitted_letters
        return Part(
            ref, side, (x, y), normalised(turn), package, value, size_from="guess",
            fitted=not unmarked and is_fitted(fitted, self._layout.header_of("fitted"), others, value),
            is_mark="fiducial" in package.lower(), line=record.line,
        )  # fmt: skip

    def _length(self, cell: str, unit: str, name: str, where: str) -> float:
        value = number_in(cell, self.units.decimal)
        if value is None:
            action = f"If the column is not {name}, state another by --columns {name}=N; else write a plain number."
            raise InputError(f"{where}: {name} is {cell!r}, but must be a number.", action=action)
        own = unit_of(cell) or (unit_of(f"1{unit}") if unit else None)
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
        turn = math.degrees(turn) if self._in_radians and turn is not None else turn
        if turn is None or abs(turn) > MOST_DEGREES:
            raise InputError(
                f"{where}: rotation is {cell!r}, but must be a number from -360 to 360 degrees.",
                action=f"If the column is not the rotation, state another by --columns rotation=N, or {NOT_THERE}.",
            )
        mirrored = cell.strip().upper().startswith(("MR", "SMR"))
        return mirrored, -turn if mirrored or self.clockwise_by else turn

    def _side(self, cell: str, ref: str, default: Side, where: str) -> Side:
        side = self._layout.sides.get(cell) or side_in_words(cell)
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
    bottom = [part.origin[0] for part in parts if part.side == "bottom"]
    top = [part.origin[0] for part in parts if part.side == "top"]
    if not bottom or min(bottom) >= 0:
        return parts, []
    if top:
        margin = _BESIDE_TOP * (max(top) - min(top))

        def share(sign: int) -> float:
            """Return the share of the parts of the bottom that lie beside those of the top, with x times a sign."""
            return sum(min(top) - margin <= sign * x <= max(top) + margin for x in bottom) / len(bottom)

        if (
            min(len(top), len(bottom)) >= _LEAST_PARTS
            and share(-1) >= _LEAST_BESIDE
            and share(-1) - share(1) >= _LEAST_DIFFERENCE
        ):
            back = [replace(p, origin=(-p.origin[0], p.origin[1])) if p.side == "bottom" else p for p in parts]
            sentence = (
                f"x of the {len(bottom)} parts of the bottom is negated: with the other sign they lie beside those of "
                "the top, where they were put. Rotations are taken as they are written."
            )
            return back, [Note("bottom-negated", sentence, count=len(bottom))]
    if max(bottom) >= 0 or (top and max(top) < 0):
        return parts, []
    sentence = (
        "x of all parts of the bottom is negative: if the program has negated it, the places are mirrored. Join the "
        "file of the board by --join, or check the board type against a run by vaoi check-board."
    )
    return parts, [Note("bottom-maybe-negated", sentence)]


# What is said about the reading.


def _notes(
    table: Table, layout: TableLayout, reader: _Reader, account: Account, lines: int, parts: int
) -> Iterator[Note]:
    shown = ", ".join(f"{name}: column {index + 1}" for name, index in layout.columns.items())
    units = reader.units_of_values
    unit = " and ".join(sorted(units)) if len(units) > 1 else next(iter(units), reader.units.unit)
    how = FIXED if table.delimiter == FIXED else f"delimiter {DELIMITER_NAMES.get(table.delimiter, table.delimiter)}"
    sentence = f"{how}; {shown}; unit {unit} ({reader.units.by}). Correct it by --columns, --delimiter or --units."
    yield Note("table-read-as", sentence, columns=shown, unit=unit)
    yield _lines_read(account, lines, parts)
    if layout.unused:
        names = ", ".join(layout.unused[:12])
        yield Note("columns-not-used", f"columns that are not used: {names}.", names=names)
    if rivals := rival_designators(layout.headers, table.rows, layout.columns["ref"]):
        chosen, others = layout.header_of("ref"), ", ".join(rivals)
        sentence = f"the designators are those of column {chosen!r}, and not of {others}, which may hold some as well."
        yield Note("designators-chosen", sentence, chosen=chosen, others=others)
    yield from _notes_on_titles(reader, account)
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
    if (header := reader.clockwise_by) and "rotation" in layout.columns:
        sentence = f"{header!r} states clockwise rotations; they were made counter-clockwise."
        yield Note("rotation-clockwise", sentence, header=header)
    if reader.units.is_guess:
        size, unit = reader.units.by, reader.units.unit
        yield Note("unit-guessed", f"the file states no unit; {unit} is taken, {size}. State it by --units.", unit=unit)


def _notes_on_titles(reader: _Reader, account: Account) -> Iterator[Note]:
    if account.sections and not reader.has_sides:
        shown = ", ".join(f"line {line}: {side}" for line, side in account.sections)
        yield Note("sides-by-titles", f"the side of parts is that of the title above them: {shown}.", titles=shown)


def _notes_on_sides(layout: TableLayout, reader: _Reader) -> Iterator[Note]:
    if reader.without_side:
        count, names, side = len(reader.without_side), ", ".join(reader.without_side[:8]), reader.default_side
        sentence = (
            f"{count} parts have no side in column {layout.header_of('side')!r}; they are taken as those of the "
            f"{side}: {names}."
        )
        yield Note("side-empty", sentence, count=count, side=side, names=names)
    if are_numbers(layout.sides) and layout.all_on is None:
        shown = ", ".join(f"{kind} as {side}" for kind, side in sorted(layout.sides.items()) if kind)
        yield Note("sides-by-number", f"the side is stated by numbers; they are taken so: {shown}.", sides=shown)
    if reader.contradicting:
        assert layout.mirror is not None
        count, names = len(reader.contradicting), ", ".join(reader.contradicting[:8])
        header = layout.headers[layout.mirror]
        sentence = f"column {header!r} says that {count} parts of the top are mirrored; they stay on the top: {names}."
        yield Note("side-contradicted", sentence, count=count, header=header, names=names)
    if "side" not in layout.columns and layout.all_on is None and not reader.marks_bottom:
        side = reader.default_side
        by = f", {reader.side_by}" if reader.side_by else ""
        sentence = (
            f"no column states the side; all parts are taken as those of the {side}{by}. State it by --columns "
            "side=bottom, or side=top."
        )
        yield Note("side-assumed", sentence, side=side)


def _lines_read(account: Account, lines: int, parts: int) -> Note:
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
