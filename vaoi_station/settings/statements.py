"""The statements of a TOML text with their places in it, so that one of them can be edited and the rest stays.

The text must be valid: `tomllib` reads it first. A statement is a table header or a key with its value. Paths are
resolved: the tables of an array have their index, so that `[cameras.features]` after the second `[[cameras]]` is
`("cameras", 1, "features")`.
"""

from __future__ import annotations

import re
import tomllib
from collections.abc import Iterator
from typing import Literal, NamedTuple

Path = tuple[str | int, ...]

_KEY = re.compile(r"""[A-Za-z0-9_-]+|"(?:[^"\\\n]|\\.)*"|'[^'\n]*'""")
_STRING = re.compile(r'''"""(?:[^\\]|\\.)*?"{3,5}|\'\'\'.*?\'{3,5}|"(?:[^"\\\n]|\\.)*"|'[^'\n]*\'''', re.DOTALL)
_BARE = re.compile(r"[^\s,\[\]{}#]+(?: \d\d:[^\s,\[\]{}#]+)?")
_BLANK = re.compile(r"(?:[ \t\r\n]|#[^\n]*)*")
_SPACE = re.compile(r"[ \t]*")


class Statement(NamedTuple):
    """A statement and where it stands, as offsets into the text."""

    kind: Literal["table", "element", "value"]
    """A header `[table]`, a header `[[element]]` of an array of tables, or a key with its value."""
    path: Path
    start: int
    """Beginning of its line."""
    value: tuple[int, int]
    """Begin and end of the value; of a header, of the header itself."""
    end: int
    """Beginning of the next line, or the end of the text."""


def statements(text: str) -> Iterator[Statement]:
    """Yield all statements of a valid TOML text, in their order."""
    counts: dict[Path, int] = {}
    table: Path = ()
    at = _skip(_BLANK, text, 0)
    while at < len(text):
        start = text.rfind("\n", 0, at) + 1
        if text[at] == "[":
            double = text.startswith("[[", at)
            names, after = _key(text, at + 1 + double)
            end = after + 1 + double
            table = _resolved((), names[:-1], counts) + (names[-1],)
            if double:
                number = counts[table] = counts.get(table, -1) + 1
                table += (number,)
            else:
                table = _resolved((), names, counts)
            kind: Literal["table", "element", "value"] = "element" if double else "table"
            path, value = table, (at, end)
        else:
            names, after = _key(text, at)
            begin = _skip(_SPACE, text, after + 1)
            end = _value_end(text, begin)
            kind, path, value = "value", table + names, (begin, end)
        line_end = text.find("\n", end) + 1 or len(text)
        yield Statement(kind, path, start, value, line_end)
        at = _skip(_BLANK, text, end)


def _resolved(base: Path, names: tuple[str, ...], counts: dict[Path, int]) -> Path:
    """Return a path of names with the index of the latest element after each array of tables."""
    for name in names:
        base += (name,)
        if base in counts:
            base += (counts[base],)
    return base


def _key(text: str, at: int) -> tuple[tuple[str, ...], int]:
    """Return the names of a dotted key, and where the sign after it stands."""
    names: list[str] = []
    while True:
        at = _skip(_SPACE, text, at)
        found = _KEY.match(text, at)
        if found is None:
            raise ValueError(f"no key at offset {at}")
        name = found[0]
        names.append(tomllib.loads(f"key = {name}")["key"] if name[0] in "\"'" else name)
        at = _skip(_SPACE, text, found.end())
        if text[at : at + 1] != ".":
            return tuple(names), at
        at += 1


def _value_end(text: str, at: int) -> int:
    """Return where a value ends. Arrays and inline tables end with the bracket that closes the first one."""
    depth = 0
    while True:
        at = _skip(_BLANK, text, at) if depth else at
        if text[at] in "[{":
            depth, at = depth + 1, at + 1
        elif text[at] in "]}":
            depth, at = depth - 1, at + 1
        elif depth and text[at] in ",=":
            at += 1
            continue
        else:
            found = _STRING.match(text, at) or _BARE.match(text, at)
            if found is None:
                raise ValueError(f"no value at offset {at}")
            at = found.end()
        if depth == 0:
            return at


def _skip(pattern: re.Pattern[str], text: str, at: int) -> int:
    found = pattern.match(text, at)
    return found.end() if found else at
