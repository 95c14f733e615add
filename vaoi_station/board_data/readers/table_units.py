"""Find the unit of the places in a centroid file, and their decimal separator."""

from __future__ import annotations

import re
from collections.abc import Iterable, Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

from vaoi_station.board_data.readers.table_columns import TableLayout
from vaoi_station.board_data.readers.table_header import Table
from vaoi_station.board_data.readers.table_rows import PartRow
from vaoi_station.board_data.readers.table_words import NUMBER, decimal_separator, is_comment, number_in
from vaoi_station.errors import InputError

UNITS = {"mm": 1.0, "inch": 25.4, "mil": 0.0254}
USUAL_SPREAD_MM = {"mm": (8.0, 1500.0), "inch": (8.0, 650.0), "mil": (8.0, 650.0)}
"""Distance of the outermost parts of a board along x or y, by the unit of its file. Long boards are drawn in mm."""
LEAST_PARTS = 2
"""With fewer parts their distance says nothing of the unit."""
_BEFORE, _AFTER = r"(?<![a-z])", r"(?![a-z])"
_UNIT_WORDS = tuple(
    (re.compile(pattern, re.IGNORECASE), unit)
    for pattern, unit in (
        (rf"(?:{_BEFORE}|(?<=[xy]))(millimet(er|re)s?|mm|metric|metrisch){_AFTER}", "mm"),
        (rf"(?:{_BEFORE}|(?<=[xy]))(mils?|thou|th|milli-?inch(es)?){_AFTER}", "mil"),
        # "in" is a word of sentences, too: it is a unit in brackets, behind a colon, or at the end of a header.
        (rf"{_BEFORE}(inch(es)?|zoll){_AFTER}|[(\[:=,]\s*in\.?\s*([)\],;]|$)|[\s_-]in$", "inch"),
        # Units that are recognised to be refused. A single m stands for metres in brackets only.
        (rf"{_BEFORE}(centimet(er|re)s?|cm){_AFTER}", "cm"),
        (rf"{_BEFORE}(micromet(er|re)s?|microns?|[uµμ]m){_AFTER}", "um"),
        (rf"{_BEFORE}(nanomet(er|re)s?|nm){_AFTER}", "nm"),
        (rf"{_BEFORE}(met(er|re)s?){_AFTER}|[(\[]m[)\]]", "m"),
        (rf"{_BEFORE}imperial{_AFTER}", "imperial"),
    )
)
_LENGTH_UNIT = r"(?:mm|mils?|thou|inch(?:es)?|zoll|in|\"|″)"
_FACTOR = re.compile(
    rf"(?<![\d.])(\d+(?:[.,]\d+)?(?:\s*/\s*\d+)?)\s*{_LENGTH_UNIT}(?![a-z])|{_LENGTH_UNIT}\s*[/*x×]?\s*\d+(?:/\d+)?",
    re.IGNORECASE,
)
_VALUE = re.compile(rf"\d\s*{_LENGTH_UNIT}(?![a-z])", re.IGNORECASE)
_STATES_UNIT = re.compile(
    r"(?<![a-z])(units?|einheit(en)?|uunits)(?![a-z])\s*(used|of measure)?\s*[:=]?|\bx\s*[,;/]\s*y\b", re.IGNORECASE
)
_OF_OTHER_LENGTHS = re.compile(
    r"height|h(oe|ö)he|thick|dicke|drill|bohr|hole|width|breite|clearance|size|größe|groesse|grid|raster|ma(ss|ß)stab",
    re.IGNORECASE,
)
_BY_SIZE = "the only one at which the board has a usual size"
_Places = Sequence[Sequence[str]]
"""The cells of x and of y."""


@dataclass(frozen=True)
class StatedUnits:
    """The unit of numbers that state none themselves, and the decimal separator."""

    unit: str
    by: str
    """What states the unit."""
    decimal: str | None
    is_guess: bool = False
    """Whether the file states no unit, and the size of the board decided."""


def stated_units(
    table: Table, layout: TableLayout, rows: Sequence[PartRow], path: Path, given: str | None
) -> StatedUnits:
    """Return the units: as given, by the header, by the values, by a comment, or by the size of the board.

    Raises:
        InputError: the file states a unit that is none of `UNITS`, several, or none.
    """
    places = [[layout.cell(cells, name) for _, cells in rows] for name in ("x", "y")]
    decimal = decimal_separator(cell for cells in places for cell in cells)
    unit, by = (given, "as given") if given is not None else _stated_unit(table, layout, rows, path)
    if unit is not None and unit not in UNITS:
        action = "State the unit of its numbers by --units." if unit == "imperial" else "Export it in mm."
        stated = f"{path}: states the unit {unit!r} ({by}), but must be one of {', '.join(UNITS)}."
        raise InputError(stated, action=action)
    if decimal is None and _may_separate_thousands(places):
        decimal = _plausible_decimal(places, unit, path)
    if unit is None:
        return StatedUnits(_plausible_unit(places, decimal, path), _BY_SIZE, decimal, is_guess=True)
    return StatedUnits(unit, by, decimal)


def _unit_word(text: str) -> str | None:
    return next((unit for pattern, unit in _UNIT_WORDS if pattern.search(text)), None)


def unit_of(cell: str) -> str | None:
    """Return the unit that a value states."""
    match = NUMBER.match(cell.strip())
    unit = match[4] if match else None
    return "inch" if unit in ('"', "″") else _unit_word(f"({unit})") if unit else None


def _stated_unit(table: Table, layout: TableLayout, rows: Sequence[PartRow], path: Path) -> tuple[str | None, str]:
    """Return the unit that a file states, which may be none of `UNITS`, and what states it."""
    headers = [layout.header_of(name) for name in ("x", "y")]
    if (factor := _refused_factor(headers)) is not None:
        return factor, "by the header"
    x, y = map(_unit_word, headers)
    if x and y and x != y:
        raise InputError(f"{path}: its header has x in {x} and y in {y}.", action="Export both in one unit.")
    if x or y:
        return x or y, "by the header"
    units, bare = set(), []
    for record, cells in rows:
        of_line = unit_of(f"1{cells[layout.unit].lower()}") if layout.unit is not None else None
        for name in ("x", "y"):
            cell = layout.cell(cells, name)
            if unit := unit_of(cell) or of_line:
                units.add(unit)
            elif number_in(cell):
                bare.append((record.line, name, cell))
    if units and not bare:
        return min(sorted(units), key=lambda unit: unit not in UNITS), "by the values"
    by_lines = dict(_units_by_lines(table, rows))
    if len(set(by_lines.values())) > 1:
        shown = ", ".join(f"{unit} in line {line}" for line, unit in by_lines.items())
        raise InputError(f"{path}: states several units: {shown}.", action="State that of x and y by --units.")
    if by_lines:
        line, unit = next(iter(by_lines.items()))
        return unit, f"by line {line}"
    if units:
        line, name, cell = bare[0]
        raise InputError(
            f"{path}, line {line}: {name} is {cell!r} without a unit, but others state {', '.join(sorted(units))}.",
            action="State the unit of the values without one by --units.",
        )
    return None, ""


def _units_by_lines(table: Table, rows: Sequence[PartRow]) -> Iterator[tuple[int, str]]:
    """Yield lines beside the parts that state a unit: those that say so, else those that have one."""
    first = rows[0][0].line
    beside = [r for r in table.records if (r.line < first or is_comment(r.cells)) and r.cells != table.headers]
    beside = [record for record in beside if not _OF_OTHER_LENGTHS.search(record.text)]
    stating = [record for record in beside if _STATES_UNIT.search(record.text) and _unit_word(record.text)]
    # A length that is stated beside its unit, such as that of a title, says nothing of x and y.
    for record in stating or [record for record in beside if not _VALUE.search(record.text)]:
        unit = _refused_factor([record.text]) if stating else None
        if unit or (unit := _unit_word(record.text)) is not None:
            yield record.line, unit


def _refused_factor(texts: Iterable[str]) -> str | None:
    """Return a unit with a factor, such as `0.01mm`, as it is written; None if there is none."""
    matches = (_FACTOR.search(text) for text in texts)
    return next((match[0] for match in matches if match is not None and match[1] != "1"), None)


def _may_separate_thousands(places: _Places) -> bool:
    """Return whether commas of numbers may separate thousands: each stands before three digits, as in `1,025`."""
    cells = [match[2] for column in places for cell in column if (match := NUMBER.match(cell.strip()))]
    return any("," in c for c in cells) and not any("." in c for c in cells)


def _plausible_decimal(places: _Places, unit: str | None, path: Path) -> str:
    """Return whether the comma separates decimals or thousands, by the size of the board; refuse if it may be both."""
    units = [unit] if unit is not None else list(UNITS)
    usual = [d for d in (",", ".") if any(_is_usual(_spread(places, d), of) for of in units)]
    if len(usual) == 1:
        return usual[0]
    cells = [cell for column in places for cell in column]
    # Programs that write three decimals write them everywhere.
    if unit != "mil" and all("," in cell or not cell for cell in cells):
        return ","
    shown = next(cell for cell in cells if "," in cell)
    raise InputError(
        f"{path}: {shown!r} may have a decimal comma, or separate thousands; nothing in the file shows which.",
        action="Export it without thousands separators" + (", or state the unit by --units." if unit is None else "."),
    )


def _spread(places: _Places, decimal: str | None) -> float:
    spreads = []
    for column in places:
        values = [v for cell in column if (v := number_in(cell, decimal)) is not None]
        spreads.append(max(values, default=0.0) - min(values, default=0.0))
    return max(spreads)


def _is_usual(spread: float, unit: str) -> bool:
    low, high = USUAL_SPREAD_MM[unit]
    return low <= spread * UNITS[unit] <= high


def _plausible_unit(places: _Places, decimal: str | None, path: Path) -> str:
    """Return the only unit at which the parts are spread over a board; refuse if there are several or none."""
    spread = _spread(places, decimal)
    if len(places[0]) < LEAST_PARTS:
        raise InputError(
            f"{path}: states no unit, and has too few parts ({len(places[0])}) to show it.",
            action="State it by --units mm, inch or mil.",
        )
    found = [unit for unit in UNITS if _is_usual(spread, unit)]
    if len(found) != 1:
        raise InputError(
            f"{path}: states no unit, and its parts are {spread:g} units apart, which is a usual board in "
            f"{' and in '.join(found) or 'no unit'}. Give --units mm, inch or mil."
        )
    return found[0]
