"""Find the lines of a centroid file that are parts, and account for all others."""

from __future__ import annotations

import re
from collections.abc import Iterator, Sequence
from dataclasses import dataclass, field
from pathlib import Path

from vaoi_station.board_data.design import Side
from vaoi_station.board_data.readers.table_columns import TableLayout
from vaoi_station.board_data.readers.table_header import DELIMITER_NAMES, DELIMITERS, FIXED, Table
from vaoi_station.board_data.readers.table_lines import RULER, Record
from vaoi_station.board_data.readers.table_words import (
    angle_in,
    header_cells,
    is_comment,
    is_usual_designator,
    looks_like_part,
    named_columns,
    number_in,
    numbers_in,
    side_in_words,
)
from vaoi_station.errors import InputError

PartRow = tuple[Record, tuple[str, ...]]
"""A record, and its cells in the columns of the layout."""
_REF_IN_TEXT = re.compile(r"(?<![\w.])[A-Za-z]{1,5}[-_$]?\d+[A-Za-z]?(?:[_.]\d+)?(?![\w.])")
_REF = re.compile(r"^[A-Za-z]{1,6}[-_$ ]?(?:\d|\?|$)")
SHOWN_CHARACTERS = 60
_TITLE_WORDS = frozenset(
    "side layer components parts part placement of on the auf der seite bauteile smd".split()  # noqa: SIM905
)
"""Words beside the side in the title of a section."""


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
    seen_part = False
    for n, record in enumerate(table.records):
        account.continued += record.lines - 1
        if n == table.header or (table.header is not None and tuple(header_cells(record.cells)) == table.headers):
            account.headers += 1
            continue
        if not record.text.strip() or RULER.match(record.text):
            account.comments += 1
            continue
        is_head = n < table.first
        if not is_head and not is_comment(record.cells):
            aligned = _aligned(record, table, layout, account)
            if aligned is not None and _is_part(aligned, layout) and not _is_shifted(aligned, table, layout):
                seen_part = True
                yield record, aligned
                continue
            if n > table.first and {"x", "y"} <= named_columns(record.cells).keys():
                line = table.records[-1 if table.header is None else table.header].line
                raise InputError(
                    f"{path}, line {record.line}: is a second header with other columns than that in line {line}.",
                    action="Import each table from a file of its own.",
                )
        side = _title_of_side(record.text) if "side" not in layout.columns else None
        if side is not None:
            account.sections.append((record.line, side))
        words = _words(record.text)
        refs = [word for word in words if is_usual_designator(word)]
        if is_head or is_comment(record.cells):
            if refs and looks_like_part(words):
                what = "stands above the header and holds" if is_head else "is a comment that holds"
                account.left_out.append(f"line {record.line} {what} {refs[0]}: {_shown(record)}")
            else:
                account.comments += 1
        # A text below the header, such as Proteus' notes, has no number.
        elif side is not None or (not seen_part and not re.search(r"\d", record.text)):
            account.comments += 1
        else:
            account.left_out.append(_described(record, table.usual_width, layout, refs))
            account.damaged += _may_hold_part(record, layout)


def _title_of_side(text: str) -> Side | None:
    words = [word for word in re.findall(r"[a-zäöüß]+", text.lower()) if word not in _TITLE_WORDS]
    sides = {side_in_words(word) for word in words}
    return sides.pop() if len(sides) == 1 else None


def _words(text: str) -> list[str]:
    return [word.strip('"') for word in re.split(r"[,;|\t!#]|\s+", text) if word.strip('"')]


def _shown(record: Record) -> str:
    text = record.text.strip()
    return repr(text if len(text) <= SHOWN_CHARACTERS else f"{text[:SHOWN_CHARACTERS]}…")


def _is_shifted(cells: Sequence[str], table: Table, layout: TableLayout) -> bool:
    """Return whether cells at spaces, or in fixed columns, are beside their columns: the designator shows it."""
    ref = layout.cell(cells, "ref")
    if table.delimiter == " " and layout.headers:
        return not is_usual_designator(ref) and any(is_usual_designator(cell) for cell in cells)
    return table.delimiter == FIXED and " " in ref and is_usual_designator(ref.split()[0])


def _may_hold_part(record: Record, layout: TableLayout) -> bool:
    """Return whether a line that cannot be read may be a damaged part: it has a designator and a number."""
    pieces = [piece.strip() for piece in re.split(r"[,;|\t!]|\s{1,}", record.text) if piece.strip()]
    numbers, ref = numbers_in(pieces), layout.cell(record.cells, "ref")
    if _REF.match(ref) and len(ref) <= 12 and numbers:
        return True
    return numbers >= 2 and any(_REF_IN_TEXT.fullmatch(piece) for piece in pieces)


def _aligned(record: Record, table: Table, layout: TableLayout, account: Account) -> tuple[str, ...] | None:
    """Return the cells of a record in the columns of the header; None if that is not possible in one way only.

    An unquoted value with the delimiter in it makes more cells; in a table of words, an empty value makes fewer.
    """
    cells, width = record.cells, table.usual_width
    if record.cut:
        return None
    surplus = len(cells) - width
    if surplus == 0 or not layout.headers:
        return cells if len(cells) > layout.last else None
    keys = {layout.columns[name] for name in ("x", "y", "rotation", "side", "ref") if name in layout.columns}
    texts = [n for n in range(width) if n not in keys]
    if surplus > 0:
        # Numbers that follow the delimiter are those of a decimal comma, not words of a value.
        merged = [(n, cells[n : n + surplus + 1]) for n in texts]
        tries = [(*cells[:n], " ".join(m), *cells[n + surplus + 1 :]) for n, m in merged if not numbers_in(m)]
    elif table.delimiter == " " and surplus == -1:
        tries = [(*cells[:n], "", *cells[n:]) for n in texts if n <= len(cells)]
    else:
        # Only words at the end of a line may be absent: else it does not show which cell is.
        used = max(*layout.columns.values(), layout.last) >= len(cells)
        numbers = any(numbers_in(row[len(cells) :]) for row in table.rows)
        tries = [] if used or numbers else [(*cells, *[""] * -surplus)]
    valid = [found for found in tries if _is_valid(found, layout)]
    if len({tuple(found[n] for n in sorted(keys)) for found in valid}) != 1:
        return None
    account.merged += surplus > 0
    return valid[0]


def _is_valid(cells: Sequence[str], layout: TableLayout) -> bool:
    ref, x, y, side = (layout.cell(cells, name) for name in ("ref", "x", "y", "side"))
    if "side" in layout.columns and side not in layout.sides and side_in_words(side) is None:
        return False
    if "rotation" in layout.columns and angle_in(layout.cell(cells, "rotation")) is None:
        return False
    return numbers_in((x, y)) == 2 and number_in(ref) is None


def _is_part(cells: Sequence[str], layout: TableLayout) -> bool:
    ref, x, y = (layout.cell(cells, name) for name in ("ref", "x", "y"))
    numbers = numbers_in((x, y))
    if not ref or (not layout.headers and numbers < 2):
        return False
    if numbers < 2 and "" in (x, y) and not is_usual_designator(ref):
        return False
    return numbers > 0 or _REF_IN_TEXT.fullmatch(ref) is not None


def _described(record: Record, width: int, layout: TableLayout, refs: Sequence[str]) -> str:
    at, shown = f"line {record.line}", _shown(record)
    if record.cut:
        return f"{at} has words across the columns: {shown}"
    for delimiter in DELIMITERS:
        if len(record.cells) < 3 and record.text.count(delimiter) >= 2:
            return f"{at} seems to have another delimiter, {DELIMITER_NAMES[delimiter]}: {shown}"
    in_column = layout.cell(record.cells, "ref")
    refs = [*([in_column] if is_usual_designator(in_column) else []), *refs]
    what = f", it seems to be part {refs[0]}: {shown}" if refs else f": {shown}"
    if len(record.cells) != width:
        return f"{at} has {len(record.cells)} of {width} cells{what}"
    return f"{at} has no designator or no place{what}"
