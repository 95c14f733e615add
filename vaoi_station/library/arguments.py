"""Checks of the arguments of public functions.

A wrong type or value raises an `InputError` that names function, argument, value and limit, before anything is read,
computed or written.
"""

from __future__ import annotations

import operator
import os
from pathlib import Path
from typing import Any

from vaoi_station.errors import InputError


def require_path(function: str, name: str, value: object) -> Path:
    """Return a path argument as `Path`."""
    # The operating system ends a path at a zero character, and Python raises ValueError for it.
    if isinstance(value, str | os.PathLike) and isinstance(path := os.fspath(value), str) and "\0" not in path:
        return Path(path)
    raise InputError.field(function, name, value, "a path, as text or pathlib.Path")


def require_text(function: str, name: str, value: object) -> str:
    """Return a text argument, which must not be empty."""
    if not isinstance(value, str) or not value:
        raise InputError.field(function, name, value, "a text that is not empty")
    return value


def require_whole(function: str, name: str, value: Any, least: int, most: int) -> int:
    """Return an integer argument, Python's or numpy's, within its limits."""
    number = whole(value)
    if number is None or not least <= number <= most:
        raise InputError.field(function, name, value, f"a whole number from {least} to {most}")
    return number


def require_instance(function: str, name: str, value: object, kind: type) -> None:
    """Refuse an argument that is not an instance of a class."""
    if not isinstance(value, kind):
        raise InputError.field(function, name, value, f"of type {kind.__name__}, not {type(value).__name__}")


def whole(value: Any) -> int | None:
    """Return an integer, Python's or numpy's, as int; None for anything else, also for booleans."""
    try:
        return None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        return None
