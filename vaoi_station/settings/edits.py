"""Edits of station.toml that leave comments, order and layout of everything else, and what callers see of it."""

from __future__ import annotations

import tomllib
from collections.abc import Iterator, Sequence
from typing import Any, NamedTuple
from urllib.parse import urlsplit

from vaoi_station.errors import InputError

Path = tuple[str | int, ...]

MARK = "…"
"""Stands where something is hidden. No address of a receiver may hold it."""


class Edit(NamedTuple):
    """One change: the value that stands at a path from now on."""

    path: Path
    value: Any
    """None removes the key, the table or the element of an array."""


def edit_toml(text: str, edits: Sequence[Edit]) -> str:
    """Return the text with all edits made, those that remove elements last.

    A path may name the element after the last one of an array of tables, which appends it.

    Raises:
        InputError: a path does not lead anywhere, or the text cannot be edited there.
    """
    import tomlkit  # here, because most starts edit nothing

    expected = tomllib.loads(text)
    document = tomlkit.parse(text)
    for edit in _ordered(edits):
        apply_edit(expected, edit)
        # The library's text is compared with the data: a file that it would damage is refused.
        try:
            apply_edit(document, edit)
            text = tomlkit.dumps(document)
            text.encode()  # a half of a surrogate pair is text in JSON, and no UTF-8
            sound = _equal(tomllib.loads(text), expected)
        except InputError:
            raise
        except (Exception, RecursionError):  # noqa: BLE001  (the library documents no errors of its edits)
            sound = False
        if not sound:
            raise InputError(
                f"{key_of(edit.path)}: cannot be changed where it stands in the file.",
                action="Change it by hand in the file, or write its table with a header of its own.",
                code="not-editable",
            )
    return text


def key_of(path: Path) -> str:
    """Return a path as it is written in messages, such as `cameras.1.width`."""
    return ".".join(map(str, path))


def apply_edit(data: Any, edit: Edit) -> None:
    """Make an edit in tables and arrays; raise InputError if its path leads through something that is neither."""
    owner = data
    for n, step in enumerate(edit.path):
        last = n == len(edit.path) - 1
        if isinstance(owner, list) and isinstance(step, int) and 0 <= step < len(owner) + (edit.value is not None):
            absent = step == len(owner)
        elif isinstance(owner, dict) and (step in owner or (edit.value is not None and isinstance(step, str))):
            absent = step not in owner
        else:
            raise InputError(f"{key_of(edit.path)}: there is no {step!r} in the file.", code="not-editable")
        if not (absent or last):
            owner = owner[step]
            continue
        value = edit.value
        for inner in reversed(edit.path[n + 1 :]):
            value = [value] if isinstance(inner, int) else {inner: value}
        if value is None:
            del owner[step]
        elif isinstance(owner, list) and absent:
            owner.append(value)
        else:
            owner[step] = value
        return


def _ordered(edits: Sequence[Edit]) -> list[Edit]:
    # An element that is removed moves those behind it: removals come last, those with the highest index first.
    whole = [edit for edit in edits if edit.value is None and isinstance(edit.path[-1], int)]
    return [e for e in edits if e not in whole] + sorted(whole, key=lambda e: e.path, reverse=True)


def _equal(read: Any, expected: Any) -> bool:
    """Return whether both are the same, where a table or an array that is empty equals one that is absent."""
    match read, expected:
        case dict(), dict():
            keys = {k for data in (read, expected) for k, v in data.items() if v not in ({}, [])}
            return all(k in read and k in expected and _equal(read[k], expected[k]) for k in keys)
        case list(), list():
            return len(read) == len(expected) and all(map(_equal, read, expected))
    return type(read) is type(expected) and bool(read == expected)


def hidden_edits(data: dict[str, Any]) -> Iterator[Edit]:
    """Yield an edit for every value that may be a secret, with what is shown instead.

    The address of an archive may name a user and a password. Everything else that is secret lies in files of its own,
    which station.toml names.
    """
    archive = data.get("archive")
    url = archive.get("url") if isinstance(archive, dict) else None
    if isinstance(url, str) and (shown := _shown(url)) != url:
        yield Edit(("archive", "url"), shown)


def without_secrets(text: str, data: dict[str, Any]) -> str:
    """Return the text of a file with all secrets hidden; `data` is what the text says."""
    return edit_toml(text, list(hidden_edits(data)))


def _shown(url: str) -> str:
    try:
        parts = urlsplit(url)
    except ValueError:
        return MARK
    host = parts.netloc.rpartition("@")[2]
    if parts.scheme in ("http", "https"):
        rest = url.split(parts.netloc, 1)[1] if parts.netloc else url
        return f"{parts.scheme}://{host}/{MARK}" if rest.strip("/") or "@" in parts.netloc else url
    if "@" in parts.netloc or parts.query:
        before = url.split("?", 1)[0].replace(parts.netloc, f"{MARK}@{host}" if "@" in parts.netloc else host, 1)
        return before + (f"?{MARK}" if parts.query else "")
    return url
