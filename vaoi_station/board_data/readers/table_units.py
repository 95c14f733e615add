"""Find the unit of the places in a centroid file, and their decimal separator."""

from __future__ import annotations

import re
from collections.abc import Sequence
from dataclasses import dataclass
from pathlib import Path

from vaoi_station.board_data.readers.table_columns import (
    NUMBER,
    TableLayout,
    decimal_separator,
    is_comment,
    number_in,
)
from vaoi_station.board_data.readers.table_header import Table
from vaoi_station.board_data.readers.table_lines import Record
from vaoi_station.errors import InputError

UNITS = {"mm": 1.0, "inch": 25.4, "mil": 0.0254}
USUAL_SPREAD_MM = (15.0, 650.0)
"""Distance of the outermost parts of a usual board along x or y."""
PartRow = tuple[Record, tuple[str, ...]]
"""A record, and its cells in the columns of the layout."""

_UNIT_WORDS = (
    (re.compile(r"(?<![a-z])(millimet(er|re)s?|mm)(?![a-z])", re.IGNORECASE), "mm"),
    (re.compile(r"(?<![a-z])(mils?|thou|th)(?![a-z])", re.IGNORECASE), "mil"),
    # "in" is a word of sentences, too: "X, Y in mils".
    (re.compile(r"(?<![a-z])(inch(es)?|zoll|in)(?![a-z])(?!\s+[a-z])|\"|″", re.IGNORECASE), "inch"),
    # Units that are recognised to be refused. A single m stands for metres in brackets only.
    (re.compile(r"(?<![a-z])(centimet(er|re)s?|cm)(?![a-z])", re.IGNORECASE), "cm"),
    (re.compile(r"(?<![a-z])(micromet(er|re)s?|microns?|[uµμ]m)(?![a-z])", re.IGNORECASE), "um"),
    (re.compile(r"(?<![a-z])(nanomet(er|re)s?|nm)(?![a-z])", re.IGNORECASE), "nm"),
    (re.compile(r"(?<![a-z])(met(er|re)s?)(?![a-z])|[(\[]m[)\]]", re.IGNORECASE), "m"),
)
_STATES_UNIT = re.compile(r"unit|einheit|\bx\s*[,;/]\s*y\b.*\b(in|-|:)\s", re.IGNORECASE)


@dataclass(frozen=True)
class StatedUnits:
    """The unit of numbers that state none themselves, and the decimal separator."""

    unit: str
    by: str
    """What states the unit."""
    decimal: str | None

    @classmethod
    def of(
        cls, table: Table, layout: TableLayout, rows: Sequence[PartRow], path: Path,
        given: str | None,
    ) -> StatedUnits:  # fmt: skip
        """Find them: as given, by the header, by the values, by a comment, or by the size of the board.

        Raises:
            InputError: the file states a unit that is none of `UNITS`, several, or none.
        """
        places = [cells[layout.columns[name]] for _, cells in rows for name in ("x", "y")]
        decimal = decimal_separator(places)
        if given is not None:
            return cls(given, "as given", decimal)
        unit, by = _stated_unit(table, layout, rows, path)
        if unit is None:
            return cls(_plausible_unit(layout, rows, decimal, path), f"{by}; the file states none", decimal)
        if unit not in UNITS:
            raise InputError(
                f"{path}: states the unit {unit!r} ({by}), but must be one of {', '.join(UNITS)}.",
                action="Export it in mm, or state the unit of its numbers by --units.",
            )
        return cls(unit, by, decimal)


def _unit_word(text: str) -> str | None:
    return next((unit for pattern, unit in _UNIT_WORDS if pattern.search(text)), None)


def unit_of(cell: str) -> str | None:
    """Return the unit that a value states."""
    match = NUMBER.match(cell.strip())
    return _unit_word(match[4]) if match and match[4] else None


def _stated_unit(table: Table, layout: TableLayout, rows: Sequence[PartRow], path: Path) -> tuple[str | None, str]:
    """Return the unit that a file states, which may be none of `UNITS`, and what states it."""
    x, y = (_unit_word(layout.header_of(name)) for name in ("x", "y"))
    if x and y and x != y:
        raise InputError(f"{path}: its header has x in {x} and y in {y}. Give --units.")
    if x or y:
        return x or y, "by the header"
    bare = []
    units = set()
    for record, cells in rows:
        for name in ("x", "y"):
            cell = cells[layout.columns[name]]
            if (unit := unit_of(cell)) is not None:
                units.add(unit)
            elif number_in(cell):
                bare.append((record.line, name, cell))
    first = rows[0][0].line
    # What no line of the head states, a line below the parts may.
    for record in table.records:
        stands_apart = record.line < first or is_comment(record.cells)
        if (
            stands_apart
            and record.cells != layout.headers
            and _STATES_UNIT.search(record.text)
            and (word := _unit_word(record.text))
        ):
            return word, f"by line {record.line}"
    if units and bare:
        line, name, cell = bare[0]
        raise InputError(
            f"{path}, line {line}: {name} is {cell!r} without a unit, but others state {', '.join(sorted(units))}.",
            action="State the unit of the values without one by --units.",
        )
    if units:
        return min(units, key=lambda unit: unit not in UNITS), "by the values"
    return None, "the only one at which the board has a usual size"


def _plausible_unit(layout: TableLayout, rows: Sequence[PartRow], decimal: str | None, path: Path) -> str:
    """Return the only unit at which the parts are spread over a usual board; refuse if there are several or none."""
    spread = []
    for name in ("x", "y"):
        values = [v for _, cells in rows if (v := number_in(cells[layout.columns[name]], decimal)) is not None]
        spread.append(max(values, default=0.0) - min(values, default=0.0))
    low, high = USUAL_SPREAD_MM
    found = [unit for unit, mm in UNITS.items() if low <= max(spread) * mm <= high]
    if len(found) != 1:
        raise InputError(
            f"{path}: states no unit, and its parts are {max(spread):g} units apart, which is a usual board in "
            f"{' and in '.join(found) or 'no unit'}. Give --units mm, inch or mil."
        )
    return found[0]
