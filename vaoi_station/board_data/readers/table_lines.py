"""Cut the lines of a table into cells: by a delimiter, at the positions of the header's words, or at spaces.

A record is one line, or several where a quoted cell has line breaks. Every line is part of a record.
"""

from __future__ import annotations

import csv
import re
from collections import Counter
from collections.abc import Sequence
from dataclasses import dataclass
from itertools import pairwise

from vaoi_station.board_data.readers.table_words import HEADERS, is_one_header, plain_key

MOST_LINES_OF_A_RECORD = 20
"""A quoted cell with more line breaks is a cell with a single quotation mark, such as an inch mark."""
MOST_WORDS = 3
"""Largest number of words of a header in columns of fixed width."""
RULER = re.compile(r"^[\s=_*+|#-]*$")
"""A line that only separates."""
MOST_CUT_WORDS = 0.2
"""Share of lines in which a boundary of columns may cut a word; above it the table has no fixed columns."""


@dataclass(frozen=True)
class Record:
    """One line of a table, or several that belong together."""

    line: int
    """Number of its first line, from 1."""
    text: str
    cells: tuple[str, ...]
    lines: int = 1
    cut: bool = False
    """Whether a boundary of the fixed columns cuts one of its words, so that its cells cannot be trusted."""


def split_lines(text: str) -> list[str]:
    """Return the lines of a text; form feeds and other separators of Unicode do not end a line."""
    lines = re.split(r"\r\n|\n|\r", text)
    return lines[:-1] if lines and not lines[-1] else lines


# By a delimiter, or at spaces.


def delimited(lines: Sequence[str], delimiter: str) -> list[Record]:
    """Return the records of a table with a delimiter.

    Quotation marks enclose cells (RFC 4180), but programs also write them as inch marks without doubling them. Of the
    ways to read a record, the first that gives the usual number of cells is taken.
    """
    simple = [_standard(line, delimiter) for line in lines]
    counts = Counter(len(cells) for cells in simple if cells is not None and len(cells) > 2)
    usual = counts.most_common(1)[0][0] if counts else 0
    records: list[Record] = []
    n = 0
    while n < len(lines):
        record = _record(lines, n, delimiter, usual)
        records.append(record)
        n += record.lines
    return records


def _record(lines: Sequence[str], n: int, delimiter: str, usual: int) -> Record:
    line = lines[n]
    literal = line.split(delimiter)
    one = [cells for cells in (_standard(line, delimiter), _lenient(line, delimiter), literal) if cells is not None]
    if line.count('"') % 2 and all(len(cells) != usual for cells in one[:-1]):  # a quoted cell that goes on
        for count in range(2, min(MOST_LINES_OF_A_RECORD, len(lines) - n) + 1):
            # A quotation mark in a full line is an inch mark if another full line follows.
            if len(literal) == usual == len(lines[n + count - 1].split(delimiter)):
                break
            if '"' not in lines[n + count - 1]:
                continue
            text = "\n".join(lines[n : n + count])
            for read in (_standard, _lenient):
                if (cells := read(text, delimiter)) is not None and len(cells) == usual:
                    return Record(n + 1, text, tuple(cells), count)
    best = next((cells for cells in one[:-1] if len(cells) == usual), one[0])
    return Record(n + 1, line, tuple(cell.strip() for cell in best))


def _standard(text: str, delimiter: str) -> list[str] | None:
    """Return the cells of a record by RFC 4180; None if a quoted cell does not end, or is followed by other text."""
    try:
        rows = list(csv.reader([text], delimiter=delimiter, strict=True, skipinitialspace=True))
    except csv.Error:
        return None
    return [_joined(cell) for cell in rows[0]] if rows else [""]


def _lenient(text: str, delimiter: str) -> list[str] | None:
    """Return the cells of a record in which a quotation mark ends a cell only before a delimiter or the end."""
    cells, at = [], 0
    closing = re.compile(rf'"[ \t]*(?={re.escape(delimiter)}|$)')
    while True:
        while text[at : at + 1] == " ":
            at += 1
        if text[at : at + 1] == '"':
            found = closing.search(text, at + 1)
            if found is None:
                return None
            cells.append(_joined(text[at + 1 : found.start()]))
            at = found.end()
        else:
            end = text.find(delimiter, at)
            end = len(text) if end < 0 else end
            cells.append(_joined(text[at:end]))
            at = end
        if at >= len(text):
            return cells
        at += 1


def _joined(cell: str) -> str:
    return " ".join(cell.split())


def spaced(lines: Sequence[str]) -> list[Record]:
    """Return the records of a table whose cells are separated by spaces or tabs."""
    words = (re.findall(r'"([^"]*)"(?=\s|$)|(\S+)', line) for line in lines)
    return [
        Record(n, line, tuple(quoted or plain for quoted, plain in found))
        for n, (line, found) in enumerate(zip(lines, words, strict=True), 1)
    ]


# At the positions of the header's words.


def fixed_width(lines: Sequence[str], header: int) -> list[Record] | None:
    """Return the records of a table with columns of fixed width, whose header is one of the lines.

    None is returned if its lines have no such columns.
    """
    lines = [line.expandtabs(8) for line in lines]
    if "  " not in lines[header].strip():
        return None
    headers = header_phrases(lines[header])
    body = [line for line in lines[header + 1 :] if line.strip() and not RULER.match(line) and line.lstrip()[:1] != "#"]
    if len(headers) < 3 or not body:
        return None
    bounds = [0]
    for (start, words), following in pairwise(headers):
        bounds.append(_boundary(body, max(start, bounds[-1]) + 1, start + len(words), *following))
    if sum(_is_cut(line, bounds) for line in body) > MOST_CUT_WORDS * len(body):
        return None
    records = []
    for n, line in enumerate(lines):
        cells = [_joined(line[a:b]) for a, b in zip(bounds, [*bounds[1:], None], strict=True)]
        cells = [c[1:-1].strip() if len(c) > 1 and c[0] == c[-1] == '"' else c for c in cells]
        if n == header:
            cells = [words for _, words in headers]
        records.append(Record(n + 1, line, tuple(cells), cut=n > header and _is_cut(line, bounds)))
    return records


def header_phrases(line: str) -> list[tuple[int, str]]:
    """Return position and words of every column of a header: `Mid X` is one, "Pad Y TB" are two.

    A single `#` before the first one is left out. "Ref PosX" are two, if no other header is that of the designators.
    """
    # A unit in brackets belongs to the word before it.
    words = [(m.start(), m.end(), m[0]) for m in re.finditer(r"[^\s(\[]+(?:\s?[(\[][^)\]]*[)\]])?|\S+", line)]
    if len(words) > 1 and not re.search(r"\w", words[0][2]):
        words = words[1:]
    found: list[tuple[int, str]] = []
    n = 0
    while n < len(words):
        count = 1
        for more in range(min(MOST_WORDS, len(words) - n), 1, -1):
            near = all(a[1] + 1 == b[0] for a, b in pairwise(words[n : n + more]))
            if near and is_one_header(" ".join(w for _, _, w in words[n : n + more])):
                count = more
                break
        found.append((words[n][0], " ".join(w for _, _, w in words[n : n + count])))
        n += count
    if not any(plain_key(phrase) in HEADERS["ref"] for _, phrase in found):
        for m, (at, phrase) in enumerate(found):
            first, space, rest = phrase.partition(" ")
            if space and plain_key(first) in HEADERS["ref"]:
                found[m : m + 1] = [(at, first), (at + len(first) + 1, rest)]
                break
    return found


def _boundary(body: Sequence[str], first: int, end: int, header: int, words: str) -> int:
    """Return where a column begins whose `words` are at `header`: behind a position that is blank in most lines.

    Values may begin at their header, left of it (numbers are set to the right) or right of it. Where all begin at the
    header, the column does; else behind the blank that is widest between the `end` of the header before and its own.
    """
    columns = range(first - 1, header + len(words))
    taken = [sum(line[at : at + 1].strip() != "" for line in body) for at in columns]
    free = [at for at, count in zip(columns, taken, strict=True) if count == min(taken)]
    following = [line[header : header + len(words)] for line in body]
    if header - 1 in free and all(part[:1].strip() or not part.strip() for part in following):
        return header
    runs: list[list[int]] = []
    for at in free:
        if runs and runs[-1][-1] == at - 1:
            runs[-1].append(at)
        else:
            runs.append([at])

    def fitness(run: list[int]) -> tuple[int, int, int]:
        return sum(end - 1 <= at <= header for at in run), len(run), -min(abs(at - header) for at in run)

    return max(runs, key=fitness)[-1] + 1


def _is_cut(line: str, bounds: Sequence[int]) -> bool:
    return any(line[at - 1 : at].strip() != "" and line[at : at + 1].strip() != "" for at in bounds[1:])
