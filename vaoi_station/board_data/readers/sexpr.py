"""S-expressions, as KiCad writes its files."""

from __future__ import annotations

import re
from collections.abc import Iterator
from contextlib import suppress
from pathlib import Path
from typing import Any

from vaoi_station.board_data.source_text import LARGEST_NUMBER, number_of
from vaoi_station.errors import InputError

MOST_DEPTH = 200
_TOKEN = re.compile(r'"((?:[^"\\]|\\.)*)"|([^\s()"]+)|([()])')
_ESCAPE = re.compile(r"\\(.)")
_PLAIN = {"n": "\n", "t": "\t", "r": "\r"}

Node = list[Any]
"""A list of texts and of further nodes."""


def parse_sexpr(text: str, where: str | Path) -> Node:
    """Return the first list of a text as nested lists of texts."""
    stack: list[Node] = [[]]
    for token in _TOKEN.finditer(text):
        quoted, atom, parenthesis = token.groups()
        if parenthesis == "(":
            stack.append([])
            if len(stack) > MOST_DEPTH + 1:
                line = text.count("\n", 0, token.start()) + 1
                raise InputError(f"{where}: is nested deeper than {MOST_DEPTH} levels, line {line}.")
        elif parenthesis == ")":
            if len(stack) == 1:
                raise InputError(f"{where}: has a ')' without '(', line {text.count(chr(10), 0, token.start()) + 1}.")
            done = stack.pop()
            stack[-1].append(done)
            if len(stack) == 1:
                return done
        elif atom is not None:
            stack[-1].append(atom)
        else:
            stack[-1].append(_ESCAPE.sub(lambda m: _PLAIN.get(m[1], m[1]), quoted) if "\\" in quoted else quoted)
    raise InputError(f"{where}: ends within a list: {len(stack) - 1} ')' are missing. The file is not complete.")


def every(node: Node, *names: str) -> Iterator[Node]:
    """Yield the lists in a node that begin with one of the names."""
    return (n for n in node if isinstance(n, list) and n and n[0] in names)


def first(node: Node, name: str) -> Node:
    """Return the first list in a node that begins with a name; an empty one without."""
    return next(every(node, name), [])


def text_of(node: Node, name: str) -> str:
    """Return the text after a name: of `(layer F.Cu)` it is `F.Cu`."""
    found = first(node, name)
    return str(found[1]) if len(found) > 1 and not isinstance(found[1], list) else ""


def numbers(node: Node, name: str = "") -> list[float]:
    """Return the numbers of a list, or of the first one in it of a name, without its other texts.

    Raises:
        InputError: one is infinite or too large; the message does not name the file.
    """
    node = first(node, name) if name else node
    found: list[float] = []
    for item in node[1:]:
        if (value := number_of(item)) is not None:
            found.append(value)
        else:
            with suppress(TypeError, ValueError):
                float(item)
                shown = " ".join(str(word) for word in node if isinstance(word, str))
                raise InputError(f"({shown:.80}): {item!r:.40} is no number from 0 to ±{LARGEST_NUMBER:g}.")
    return found
