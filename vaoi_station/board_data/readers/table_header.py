"""Find the table in the lines of a centroid file: how its cells are separated, and where its header is."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

from vaoi_station.board_data.readers.table_columns import (
    header_cells,
    is_comment,
    is_known_header,
    is_ref_header,
    looks_like_part,
    named_columns,
    number_in,
    plain_key,
)
from vaoi_station.board_data.readers.table_lines import (
    RULER,
    Record,
    delimited,
    fixed_width,
    header_phrases,
    spaced,
)

FIXED = "columns of fixed width"
HEADER_LINES = 200
"""A header stands in one of the first lines."""
DELIMITERS = ("\t", ";", "|", ",", "!")
_LENGTH = r"([+-]?[\d.]+\s*[a-z\"]*)"
_PLACE_IN_ONE_CELL = re.compile(rf"^\(?\s*{_LENGTH}(?:\s*[,;/]\s*|\s+){_LENGTH}\s*\)?$", re.IGNORECASE)
_PLACE_HEADERS = frozenset(
    ("position", "pos", "location", "loc", "coordinates", "coordinate", "koordinaten", "ort", "xy")
)


@dataclass(frozen=True)
class Table:
    """The records of a file as one delimiter makes them, and its header."""

    delimiter: str
    records: tuple[Record, ...]
    header: int | None
    """Index of the record with the header; None without one."""
    is_understood: bool
    """Whether the header names x and y."""

    @property
    def headers(self) -> tuple[str, ...]:
        """The cells of the header; empty without one."""
        return () if self.header is None else self.records[self.header].cells

    @cached_property
    def rows(self) -> list[tuple[str, ...]]:
        """The cells of the records that look like parts."""
        usual = self.usual_width
        below = self.records[0 if self.header is None else self.header + 1 :]
        # Empty cells at the end of a line may be absent; at spaces, cells may be absent anywhere.
        least = usual if self.delimiter == " " or self.header is None else min(usual, 3)
        found = [r.cells for r in below if least <= len(r.cells) <= usual and not r.cut and looks_like_part(r.cells)]
        return [(*cells, *[""] * (usual - len(cells))) for cells in found]

    @cached_property
    def usual_width(self) -> int:
        """How many cells a part has."""
        if self.header is not None:
            return len(self.headers)
        return _usual_width(self.records)


def _usual_width(records: Sequence[Record]) -> int:
    counts = Counter(len(r.cells) for r in records if looks_like_part(r.cells))
    return counts.most_common(1)[0][0] if counts else 0


def find_table(lines: Sequence[str], delimiter: str | None = None) -> Table:
    """Return the table by the delimiter that makes a header that is understood, and of most lines parts."""
    chosen: tuple[str, ...] = (*DELIMITERS, FIXED, " ")
    if delimiter is not None:
        chosen = (FIXED, " ") if delimiter == " " else (delimiter,)
    tables = [table for way in chosen if (table := _table(lines, way)) is not None]

    def fitness(table: Table) -> tuple[bool, int, int]:
        return table.is_understood, len(table.rows), len(named_columns(table.headers))

    return max(tables, key=fitness)


def _numbers_in(cells: Sequence[str]) -> int:
    return sum(number_in(cell) is not None for cell in cells)


def _table(lines: Sequence[str], delimiter: str) -> Table | None:
    if delimiter == FIXED:
        header = next((n for n, line in enumerate(lines[:HEADER_LINES]) if _is_fixed_header(line)), None)
        records = None if header is None else fixed_width(lines, header, is_known_header, is_ref_header)
        if records is None:
            return None
    else:
        records = spaced(lines) if delimiter == " " else delimited(lines, delimiter)
        header = next((n for n, r in enumerate(records[:HEADER_LINES]) if _names_place(r.cells)), None)
    is_understood = header is not None
    if header is None:
        header = _unknown_header(records, delimiter)
    records = _with_plain_header(records, header, delimiter)
    return Table(delimiter, tuple(_with_place_in_two_cells(records, header)), header, is_understood)


def _is_fixed_header(line: str) -> bool:
    """Return whether a line without a delimiter names x and y, or both in one column."""
    words = line.strip().lstrip("#!%; ").split()
    if len(words) < 3 or _numbers_in(words) > 0 or any(line.count(delimiter) > 1 for delimiter in ";|,"):
        return False
    # "Mid X" may be one header, or "Pad Y" and "TB" two.
    named = named_columns([*words, *(" ".join(pair) for pair in pairwise(words))])
    in_one = any(plain_key(word) in _PLACE_HEADERS for word in words)
    return ("x" in named and "y" in named) or (in_one and "ref" in named)


def _names_place(cells: Sequence[str]) -> bool:
    """Return whether cells are a header that names x and y, or both in one column."""
    found = header_cells(cells)
    if len(found) < 3 or _numbers_in(found) > 0:
        return False
    named = named_columns(found)
    in_one = any(plain_key(cell) in _PLACE_HEADERS for cell in found)
    return ("x" in named and "y" in named) or (in_one and "ref" in named)


def _unknown_header(records: Sequence[Record], delimiter: str) -> int | None:
    """Return the record before the parts that has as many cells as they have and no number: a header in other words."""
    parts = [n for n, r in enumerate(records) if not is_comment(r.cells) and looks_like_part(r.cells)]
    if not parts:
        return None
    usual = Counter(len(records[n].cells) for n in parts).most_common(1)[0][0]
    for n in range(parts[0] - 1, -1, -1):
        record = records[n]
        if not record.text.strip() or RULER.match(record.text):
            continue
        cells = header_cells(record.cells)
        is_header = len(cells) == usual and _numbers_in(cells) == 0 and all(cells)
        if is_header and not (delimiter == " " and is_comment(record.cells)):
            return n
        if not is_comment(record.cells):
            return None
    return None


def _with_plain_header(records: Sequence[Record], header: int | None, delimiter: str) -> list[Record]:
    """Return the records with a header without the signs of a comment, and without empty cells at the ends of lines."""
    found = list(records)
    if header is None:
        return found
    cells = found[header].cells
    usual = _usual_width(found[header + 1 :])
    if delimiter == " " and len(cells) != usual:
        # Headers of two words, and a `#` before the first one.
        phrases = tuple(words for _, words in header_phrases(found[header].text, is_known_header, is_ref_header))
        ways = (phrases, cells[1:] if not re.search(r"\w", cells[0]) else ())
        cells = next((way for way in ways if len(way) == usual), cells)
    cells = tuple(header_cells(cells))
    while len(cells) > 1 and not cells[-1] and usual < len(cells):
        cells = cells[:-1]
    found[header] = replace(found[header], cells=cells)
    for n in range(header + 1, len(found)):
        surplus = found[n].cells[len(cells) :]
        if surplus and not any(surplus):
            found[n] = replace(found[n], cells=found[n].cells[: len(cells)])
    if (
        len(cells) > 1
        and not cells[-1]
        and not any(r.cells[len(cells) - 1 : len(cells)] not in ((), ("",)) for r in found[header + 1 :])
    ):
        width = len(cells) - 1
        found[header:] = [replace(r, cells=r.cells[:width]) for r in found[header:]]
    return found


def _with_place_in_two_cells(records: list[Record], header: int | None) -> list[Record]:
    """Return the records with a column such as EAGLE's `Position (mil)`, "(1000 2000)", as two columns."""
    if header is None:
        return [_with_split_place(r) if r.cells[1:2] and not looks_like_part(r.cells) else r for r in records]
    if "x" in named_columns(records[header].cells):
        return records
    cells = records[header].cells
    for n, cell in enumerate(cells):
        values = [r.cells[n] for r in records[header + 1 :] if len(r.cells) == len(cells) and r.cells[n]]
        pairs = sum(_PLACE_IN_ONE_CELL.match(value) is not None for value in values)
        if plain_key(cell) not in _PLACE_HEADERS or not values or pairs < 0.9 * len(values):
            continue
        unit = "".join(re.findall(r"[\(\[].*?[\)\]]", cell))

        def parted(record: Record, n: int = n) -> Record:
            match = _PLACE_IN_ONE_CELL.match(record.cells[n]) if len(record.cells) == len(cells) else None
            both = match.groups() if match else ()
            return replace(record, cells=(*record.cells[:n], *both, *record.cells[n + 1 :])) if both else record

        named = replace(records[header], cells=(*cells[:n], f"X {unit}", f"Y {unit}", *cells[n + 1 :]))
        return [named if m == header else parted(record) for m, record in enumerate(records)]
    return records


def _with_split_place(record: Record) -> Record:
    """Return a record of a table without header, with a second cell that holds x and y as two cells (Allegro)."""
    match = _PLACE_IN_ONE_CELL.match(record.cells[1])
    if match is None or len(record.cells) < 3:
        return record
    return replace(record, cells=(record.cells[0], *match.groups(), *record.cells[2:]))
