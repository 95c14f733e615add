"""Edits of a TOML text line by line: values change, comments, order and layout of everything else stay.

Every edit is proved: the new text is parsed and compared with the old data after the same change. A text that cannot
be edited this way is refused, never damaged.
"""

from __future__ import annotations

import copy
import json
import re
import tomllib
from collections.abc import Iterable, Sequence
from typing import Any, NamedTuple

from vaoi_station.errors import InputError
from vaoi_station.settings.statements import Path, Statement, statements

_BARE_KEY = re.compile(r"[A-Za-z0-9_-]+")


class Edit(NamedTuple):
    """One change: the value that stands at a path from now on."""

    path: Path
    value: Any
    """None removes the key, the table or the element of an array."""


def edit_toml(text: str, edits: Sequence[Edit]) -> str:
    """Return the text with all edits made, those that remove elements last.

    A path may name the element after the last one of an array of tables, which appends it.

    Raises:
        InputError: a path does not lead anywhere, or the text cannot be edited line by line there.
    """
    for edit in _ordered(edits):
        try:
            expected = changed(tomllib.loads(text), edit)
            new = _edited(text, edit)
            new.encode()  # a half of a surrogate pair is text in JSON, and no UTF-8
            sound = _equal(tomllib.loads(new), expected)
        except (ValueError, RecursionError):
            sound = False
        if not sound:
            raise InputError(
                f"{key_of(edit.path)}: cannot be changed line by line where it stands in the file.",
                action="Change it by hand in the file, or write its table with a header of its own.",
                code="not-editable",
            )
        text = new
    return text


def key_of(path: Path) -> str:
    """Return a path as it is written in messages, such as `cameras.1.width`."""
    return ".".join(map(str, path))


def changed(data: Any, edit: Edit) -> Any:
    """Return data after an edit; raise InputError if its path leads through something that is no table or array."""
    data = copy.deepcopy(data)
    owner = data
    for step, following in zip(edit.path[:-1], edit.path[1:], strict=True):
        if isinstance(owner, list) and step == len(owner) and edit.value is not None:
            owner.append({})
        elif isinstance(owner, dict) and step not in owner and edit.value is not None:
            owner[step] = [] if isinstance(following, int) else {}
        owner = _inside(owner, step, edit.path)
    last = edit.path[-1]
    if isinstance(owner, list) and last == len(owner) and edit.value is not None:
        owner.append(edit.value)
    elif isinstance(owner, dict) and edit.value is not None:
        owner[last] = edit.value
    else:
        _inside(owner, last, edit.path)
        if edit.value is None:
            del owner[last]
        else:
            owner[last] = edit.value
    return data


def _equal(found: Any, expected: Any) -> bool:
    """Return whether both are the same, where a table or an array that is empty equals one that is absent.

    The last key of `[line.encoder]` leaves an empty table, that of `encoder.row_mm` none.
    """
    match found, expected:
        case dict(), dict():
            keys = {k for data in (found, expected) for k, v in data.items() if v not in ({}, [])}
            return all(k in found and k in expected and _equal(found[k], expected[k]) for k in keys)
        case list(), list():
            return len(found) == len(expected) and all(map(_equal, found, expected))
    return type(found) is type(expected) and bool(found == expected)


def toml_value(value: Any) -> str:
    """Return a value of JSON as TOML writes it, on one line."""
    match value:
        case bool():
            return "true" if value else "false"
        case int() | float():
            return repr(value)
        case str():
            return json.dumps(value, ensure_ascii=False)
        case list() | tuple():
            return f"[{', '.join(toml_value(v) for v in value)}]"
        case dict():
            inside = ", ".join(f"{_name(key)} = {toml_value(v)}" for key, v in value.items())
            return f"{{ {inside} }}" if inside else "{}"
    raise InputError(f"{value!r:.80} is no value that station.toml can hold.")


def _inside(owner: Any, step: str | int, path: Path) -> Any:
    if isinstance(owner, dict) and step in owner:
        return owner[step]
    if isinstance(owner, list) and isinstance(step, int) and 0 <= step < len(owner):
        return owner[step]
    raise InputError(f"{key_of(path)}: there is no {step!r} in the file.", code="not-editable")


def _ordered(edits: Sequence[Edit]) -> list[Edit]:
    # An element that is removed moves those behind it: removals come last, those with the highest index first.
    whole = [edit for edit in edits if edit.value is None and isinstance(edit.path[-1], int)]
    return [e for e in edits if e not in whole] + sorted(whole, key=lambda e: e.path, reverse=True)


def _edited(text: str, edit: Edit) -> str:
    path, value = edit
    found = list(statements(text))
    for statement in found:
        if statement.kind == "value" and path[: len(statement.path)] == statement.path:
            return _in_statement(text, statement, edit)
    if value is None:
        return _without(text, found, path)
    if isinstance(value, dict) and value and not any(isinstance(step, int) for step in path):
        return _appended(text, f"[{_header(path)}]", value)
    return _added(text, found, edit)


def _in_statement(text: str, statement: Statement, edit: Edit) -> str:
    """Change the value of a statement, or what its inline value holds at the path."""
    inner = edit.path[len(statement.path) :]
    begin, end = statement.value
    if not inner:
        if edit.value is None:
            return text[: statement.start] + text[statement.end :]
        return text[:begin] + toml_value(edit.value) + text[end:]
    held = tomllib.loads(f"value = {text[begin:end]}")["value"]
    return text[:begin] + toml_value(changed(held, Edit(inner, edit.value))) + text[end:]


def _without(text: str, found: Sequence[Statement], path: Path) -> str:
    """Remove a table or an element of an array of tables: its statements, and those of the tables in it."""
    for statement in reversed(found):
        if statement.path[: len(path)] == path:
            text = text[: statement.start] + text[statement.end :]
    return text


def _added(text: str, found: Sequence[Statement], edit: Edit) -> str:
    """Write a key that the file does not have, behind the last key of its table."""
    path, value = edit
    if isinstance(path[-1], int):
        return _with_element(text, found, path, value)
    for length in range(len(path) - 1, -1, -1):
        owner = path[:length]
        if isinstance(owner[-1:][0] if owner else None, int) and not _headers(found, owner):
            text = _with_element(text, found, owner, {})
            found = list(statements(text))
        if owner == () or _headers(found, owner):
            # A table inside the file's own level is clearer under a header of its own.
            if owner == () and length < len(path) - 1:
                return _appended(text, f"[{_header(path[:-1])}]", {path[-1]: value})
            at = _end_of(found, owner)
            return _insert(text, at, f"{'.'.join(_name(step) for step in path[length:])} = {toml_value(value)}\n")
    raise ValueError("no table")


def _headers(found: Iterable[Statement], path: Path) -> list[int]:
    return [n for n, s in enumerate(found) if s.kind != "value" and s.path == path]


def _end_of(found: Sequence[Statement], table: Path) -> int:
    """Return the offset behind the last key of a table, the header's own if it has none."""
    headers = _headers(found, table)
    first = headers[0] + 1 if headers else 0
    at = found[headers[0]].end if headers else 0
    for statement in found[first:]:
        if statement.kind != "value":
            break
        at = statement.end
    return at


def _with_element(text: str, found: Sequence[Statement], path: Path, value: Any) -> str:
    """Append an element to an array of tables, behind everything that belongs to the one before."""
    if not isinstance(value, dict):
        raise ValueError("an element of an array of tables is a table")
    lines = [f"[[{_header(path[:-1])}]]"] + [f"{_name(key)} = {toml_value(v)}" for key, v in value.items()]
    ends = [s.end for s in found if s.path[: len(path) - 1] == path[:-1]]
    block = "\n".join(lines) + "\n"
    return _insert(text, ends[-1], f"\n{block}") if ends else _append(text, block)


def _appended(text: str, header: str, values: dict[Any, Any]) -> str:
    lines = [header] + [f"{_name(key)} = {toml_value(v)}" for key, v in values.items()]
    return _append(text, "\n".join(lines) + "\n")


def _append(text: str, block: str) -> str:
    return _insert(text, len(text), f"\n{block}" if text else block)


def _insert(text: str, at: int, lines: str) -> str:
    # The last line of a file may have no end.
    gap = "" if at == 0 or text[at - 1] == "\n" else "\n"
    return text[:at] + gap + lines + text[at:]


def _header(path: Path) -> str:
    return ".".join(_name(step) for step in path if not isinstance(step, int))


def _name(step: object) -> str:
    text = str(step)
    return text if _BARE_KEY.fullmatch(text) else json.dumps(text, ensure_ascii=False)
