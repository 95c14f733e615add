"""Find the table in the lines of a centroid file: how its cells are separated, and where its header is."""

from __future__ import annotations

import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass, replace
from functools import cached_property
from itertools import pairwise

from vaoi_station.board_data.readers.table_lines import RULER, Record, delimited, fixed_width, header_phrases, spaced
from vaoi_station.board_data.readers.table_words import (
    header_cells,
    is_comment,
    looks_like_part,
    named_columns,
    numbers_in,
    plain_key,
)

FIXED = "columns of fixed width"
HEADER_LINES = 200
"""A header stands in one of the first lines."""
DELIMITERS = ("\t", ";", "|", ",", "!")
DELIMITER_NAMES = {",": "comma", ";": "semicolon", "\t": "tab", " ": "spaces", "|": "bar", "!": "exclamation mark"}
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

    @property
    def first(self) -> int:
        """Index of the first record below the header."""
        return 0 if self.header is None else self.header + 1

    @cached_property
    def rows(self) -> list[tuple[str, ...]]:
        """The cells of the records that look like parts."""
        usual = self.usual_width
        # Empty cells at the end of a line may be absent; at spaces, cells may be absent anywhere.
        least = usual if self.delimiter == " " or self.header is None else min(usual, 3)
        below = (r for r in self.records[self.first :] if least <= len(r.cells) <= usual and not r.cut)
        return [(*r.cells, *[""] * (usual - len(r.cells))) for r in below if looks_like_part(r.cells)]

    @cached_property
    def usual_width(self) -> int:
        """How many cells a part has."""
        return _usual_width(self.records) if self.header is None else len(self.headers)


def _usual_width(records: Sequence[Record]) -> int:
    counts = Counter(len(r.cells) for r in records if looks_like_part(r.cells))
    return counts.most_common(1)[0][0] if counts else 0


def find_table(lines: Sequence[str], delimiter: str | None = None) -> Table:
    """Return the table by the delimiter that makes a header that is understood, and of most lines parts."""
    chosen: tuple[str, ...] = (*DELIMITERS, FIXED, " ")
    if delimiter is not None:
        chosen = (FIXED, " ") if delimiter == " " else (delimiter,)
    tables = [table for way in chosen if (table := _table(lines, way)) is not None]
    return max(tables, key=lambda table: (table.is_understood, len(table.rows), len(named_columns(table.headers))))


def _table(lines: Sequence[str], delimiter: str) -> Table | None:
    if delimiter == FIXED:
        header = next((n for n, line in enumerate(lines[:HEADER_LINES]) if _is_fixed_header(line)), None)
        records = None if header is None else fixed_width(lines, header)
        if records is None:
            return None
    else:
        records = spaced(lines) if delimiter == " " else delimited(lines, delimiter)
        heads = enumerate(header_cells(r.cells) for r in records[:HEADER_LINES])
        header = next((n for n, cells in heads if _names_place(cells, cells)), None)
    is_understood = header is not None
    if header is None:
        header = _unknown_header(records, delimiter)
    if header is not None:
        records = _with_plain_header(records, header, delimiter)
    return Table(delimiter, tuple(_with_place_in_two_cells(records, header)), header, is_understood)


def _is_fixed_header(line: str) -> bool:
    words = line.strip().lstrip("#!%; ").split()
    if any(line.count(delimiter) > 1 for delimiter in ";|,"):
        return False
    # "Mid X" may be one header, or "Pad Y" and "TB" two.
    return _names_place(words, [*words, *(" ".join(pair) for pair in pairwise(words))])


def _names_place(cells: Sequence[str], headers: Sequence[str]) -> bool:
    """Return whether cells are a header that names x and y, or both in one column."""
    if len(cells) < 3 or numbers_in(cells) > 0:
        return False
    named = named_columns(headers)
    in_one = any(plain_key(cell) in _PLACE_HEADERS for cell in cells)
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
        is_header = len(cells) == usual and numbers_in(cells) == 0 and all(cells)
        if is_header and not (delimiter == " " and is_comment(record.cells)):
            return n
        if not is_comment(record.cells):
            return None
    return None


def _with_plain_header(records: Sequence[Record], header: int, delimiter: str) -> list[Record]:
    """Return the records with a header without the signs of a comment, and without empty cells at the ends of lines."""
    cells, below = records[header].cells, records[header + 1 :]
    usual = _usual_width(below)
    if delimiter == " " and len(cells) != usual:
        # Headers of two words, and a `#` before the first one.
        phrases = tuple(words for _, words in header_phrases(records[header].text))
        ways = (phrases, cells[1:] if not re.search(r"\w", cells[0]) else ())
        cells = next((way for way in ways if len(way) == usual), cells)
    cells = tuple(header_cells(cells))
    while len(cells) > 1 and not cells[-1] and usual < len(cells):
        cells = cells[:-1]
    width = len(cells)
    below = [r if any(r.cells[width:]) else replace(r, cells=r.cells[:width]) for r in below]
    if width > 1 and not cells[-1] and all(r.cells[width - 1 : width] in ((), ("",)) for r in below):
        cells, below = cells[:-1], [replace(r, cells=r.cells[: width - 1]) for r in below]
    return [*records[:header], replace(records[header], cells=cells), *below]


def _with_place_in_two_cells(records: Sequence[Record], header: int | None) -> Sequence[Record]:
    """Return the records with a column such as EAGLE's `Position (mil)`, "(1000 2000)", as two columns."""
    if header is None:  # Allegro
        return [_with_split_place(r, 1) if len(r.cells) > 2 and not looks_like_part(r.cells) else r for r in records]
    cells = records[header].cells
    if "x" in named_columns(cells):
        return records
    full = [r for r in records[header + 1 :] if len(r.cells) == len(cells)]
    for n, cell in enumerate(cells):
        values = [r.cells[n] for r in full if r.cells[n]]
        pairs = sum(_PLACE_IN_ONE_CELL.match(value) is not None for value in values)
        if plain_key(cell) in _PLACE_HEADERS and values and pairs >= 0.9 * len(values):
            unit = "".join(re.findall(r"[\(\[].*?[\)\]]", cell))
            named = replace(records[header], cells=(*cells[:n], f"X {unit}", f"Y {unit}", *cells[n + 1 :]))
            parted = [_with_split_place(r, n) if len(r.cells) == len(cells) else r for r in records]
            return [*parted[:header], named, *parted[header + 1 :]]
    return records


def _with_split_place(record: Record, n: int) -> Record:
    """Return a record with a cell that holds x and y as two cells."""
    match = _PLACE_IN_ONE_CELL.match(record.cells[n])
    both = match.groups() if match else (record.cells[n],)
    return replace(record, cells=(*record.cells[:n], *both, *record.cells[n + 1 :]))
