"""Find the lines of a centroid file that are parts, and account for all others."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from vaoi_station.board_data.design import Side
from vaoi_station.board_data.readers.table_columns import (
    TableLayout,
    angle_in,
    header_cells,
    is_comment,
    is_usual_designator,
    looks_like_part,
    named_columns,
    number_in,
    side_in_words,
)
from vaoi_station.board_data.readers.table_header import DELIMITERS, Table
from vaoi_station.board_data.readers.table_lines import RULER, Record
from vaoi_station.errors import InputError

DELIMITER_NAMES = {",": "comma", ";": "semicolon", "\t": "tab", " ": "spaces", "|": "bar", "!": "exclamation mark"}
PartRow = tuple[Record, tuple[str, ...]]
"""A record, and its cells in the columns of the layout."""
_REF_IN_TEXT = re.compile(r"(?<![\w.])[A-Za-z]{1,5}[-_$]?\d+[A-Za-z]?(?:[_.]\d+)?(?![\w.])")
_REF = re.compile(r"^[A-Za-z]{1,6}[-_$ ]?(?:\d|\?|$)")
SHOWN_CHARACTERS = 60
_TITLE_CHARACTERS = 60
"""A longer line is no title of a section."""


@dataclass
class Account:
    """What became of every line."""

    comments: int = 0
    """Comments, titles, rulers and blank lines."""
    headers: int = 0
    continued: int = 0
    """Lines after the first one of a record."""
    unplaced: list[str] = field(default_factory=list)
    """Designators of parts without x and y."""
    left_out: list[str] = field(default_factory=list)
    """What each line seems to hold."""
    damaged: int = 0
    """Number of lines among `left_out` that seem to hold a part."""
    merged: int = 0
    """Number of parts whose line has more cells than the header."""
    sections: list[tuple[int, Side]] = field(default_factory=list)
    """Lines that are titles of the parts of one side."""


def part_rows(table: Table, layout: TableLayout, account: Account, path: Path) -> Iterator[PartRow]:
    """Yield the records with a part, their cells in the columns of the layout; account for all others.

    Raises:
        InputError: a second header has other columns than the first.
    """
    width = table.usual_width()
    seen_part = False
    for n, record in enumerate(table.records):
        account.continued += record.lines - 1
        if n == table.header or (table.header is not None and tuple(header_cells(record.cells)) == table.headers):
            account.headers += 1
        elif not record.text.strip() or RULER.match(record.text) or n < layout.first:
            account.comments += 1
        elif is_comment(record.cells):
            cells = tuple(header_cells(record.cells))
            if len(cells) == width and looks_like_part(cells):
                account.left_out.append(f"line {record.line} is a comment that holds {cells[layout.columns['ref']]!r}")
            else:
                account.comments += 1
        else:
            aligned = _aligned(record, width, layout, account, table.delimiter == " ")
            if aligned is not None and _is_part(aligned, layout):
                seen_part = True
                yield record, aligned
                continue
            if n > layout.first and {"x", "y"} <= named_columns(record.cells).keys():
                raise InputError(
                    f"{path}, line {record.line}: is a second header with other columns than that in line "
                    f"{table.records[layout.header].line}.",
                    action="Import each table from a file of its own.",
                )
            side = _title_of_side(record.text) if "side" not in layout.columns else None
            if side is not None:
                account.sections.append((record.line, side))
            damaged = _may_hold_part(record, layout)
            if side is not None or (not seen_part and not damaged):
                account.comments += 1
            else:
                account.left_out.append(_described(record, width, layout))
                account.damaged += damaged


def _title_of_side(text: str) -> Side | None:
    """Return the side of the parts below a title such as "Bottom side"."""
    plain = len(text) <= _TITLE_CHARACTERS and not re.search(r"\d", text)
    return side_in_words(text) if plain else None


def _may_hold_part(record: Record, layout: TableLayout) -> bool:
    """Return whether a line that cannot be read may be a damaged part: it has a designator and a number."""
    cells = record.cells
    at = layout.columns["ref"]
    pieces = [piece.strip() for piece in re.split(r"[,;|\t!]|\s{1,}", record.text) if piece.strip()]
    numbers = sum(number_in(piece) is not None for piece in pieces)
    if at < len(cells) and _REF.match(cells[at]) and len(cells[at]) <= 12 and numbers:
        return True
    return numbers >= 2 and any(_REF_IN_TEXT.fullmatch(piece) for piece in pieces)


def _aligned(
    record: Record, width: int, layout: TableLayout, account: Account, is_spaced: bool
) -> tuple[str, ...] | None:
    """Return the cells of a record in the columns of the header; None if that is not possible in one way only.

    An unquoted value with the delimiter in it makes more cells; in a table of words, an empty value makes fewer.
    """
    cells = record.cells
    if record.cut:
        return None
    surplus = len(cells) - width
    if surplus == 0 or not layout.headers:
        return cells if len(cells) > layout.last else None
    keys = {layout.columns[name] for name in ("x", "y", "rotation", "side", "ref") if name in layout.columns}
    texts = [n for n in range(width) if n not in keys]
    if surplus > 0:
        # Numbers that follow the delimiter are those of a decimal comma, not words of a value.
        tries = [
            (*cells[:n], " ".join(cells[n : n + surplus + 1]), *cells[n + surplus + 1 :])
            for n in texts
            if not any(number_in(cell) is not None for cell in cells[n + 1 : n + surplus + 1])
        ]
    elif is_spaced and surplus == -1:
        tries = [(*cells[:n], "", *cells[n:]) for n in texts if n <= len(cells)]
    else:
        used = [n for n in layout.columns.values() if n >= len(cells)]
        return None if used or len(cells) <= layout.last else (*cells, *[""] * -surplus)
    valid = [found for found in tries if _is_valid(found, layout)]
    if len({tuple(found[n] for n in sorted(keys)) for found in valid}) != 1:
        return None
    account.merged += surplus > 0
    return valid[0]


def _is_valid(cells: Sequence[str], layout: TableLayout) -> bool:
    """Return whether the cells of a line are what its columns are to hold."""
    columns = layout.columns
    if any(number_in(cells[columns[name]]) is None for name in ("x", "y")):
        return False
    if "rotation" in columns and angle_in(cells[columns["rotation"]]) is None:
        return False
    if "side" in columns and cells[columns["side"]] not in layout.sides:
        return False
    return number_in(cells[columns["ref"]]) is None


def _is_part(cells: Sequence[str], layout: TableLayout) -> bool:
    """Return whether the cells of a line are those of a part, perhaps with a wrong value."""
    ref = cells[layout.columns["ref"]]
    x, y = (cells[layout.columns[name]] for name in ("x", "y"))
    numbers = [number_in(cell) is not None for cell in (x, y)]
    if not ref or (not layout.headers and not all(numbers)):
        return False
    return any(numbers) or _REF_IN_TEXT.fullmatch(ref) is not None


def _described(record: Record, width: int, layout: TableLayout) -> str:
    """Return what a line that cannot be read seems to hold."""
    at, shown = f"line {record.line}", record.text.strip()
    if len(shown) > SHOWN_CHARACTERS:
        shown = f"{shown[:SHOWN_CHARACTERS]}…"
    if record.cut:
        return f"{at} has words across the columns: {shown!r}"
    for delimiter in DELIMITERS:
        if len(record.cells) < 3 and record.text.count(delimiter) >= 2:
            return f"{at} seems to have another delimiter, {DELIMITER_NAMES[delimiter]}: {shown!r}"
    ref_at = layout.columns["ref"]
    in_column = record.cells[ref_at : ref_at + 1]
    refs = [word for word in (*in_column, *re.split(r"[,;|\t!]|\s+", record.text)) if is_usual_designator(word)]
    what = f", it seems to be part {refs[0]}: {shown!r}" if refs else f": {shown!r}"
    if len(record.cells) != width:
        return f"{at} has {len(record.cells)} of {width} cells{what}"
    return f"{at} has no designator or no place{what}"
