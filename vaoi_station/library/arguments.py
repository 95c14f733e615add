"""Checks of the arguments of public functions.

An argument of a wrong type or value raises an `InputError` that names the function, the argument, its value and the
expected value. It is raised before anything is read, computed or written. A `TypeError` is raised only for a wrong
number or name of arguments.
"""

from __future__ import annotations

import math
import operator
import os
from pathlib import Path
from typing import Any

from vaoi_station.errors import InputError


def require_path(function: str, name: str, value: object) -> Path:
    """Return a path argument as `Path`."""
    if isinstance(value, str | Path) or (isinstance(value, os.PathLike) and isinstance(os.fspath(value), str)):
        path = Path(value)
        # The operating system ends a path at this character, and Python raises ValueError for it.
        if "\0" not in str(path):
            return path
    raise InputError.field(function, name, value, "a path, as text or pathlib.Path")


def require_text(function: str, name: str, value: object) -> str:
    """Return a text argument; raise an error for an empty text."""
    if not isinstance(value, str) or not value:
        raise InputError.field(function, name, value, "a text that is not empty")
    return value


def require_whole(function: str, name: str, value: Any, least: int, most: int) -> int:
    """Return an integer argument, Python's or numpy's, within its limits."""
    number = whole(value)
    if number is None or not least <= number <= most:
        raise InputError.field(function, name, value, f"a whole number from {least} to {most}")
    return number


def require_number(function: str, name: str, value: Any, least: float, most: float) -> float:
    """Return a real argument within its limits; NaN is outside them."""
    try:
        number = math.nan if isinstance(value, str | bytes | bool) else float(value)
    except (TypeError, ValueError, OverflowError):
        number = math.nan
    if not least <= number <= most:
        raise InputError.field(function, name, value, f"a number from {least:g} to {most:g}")
    return number


def require_instance(function: str, name: str, value: object, *kinds: type) -> None:
    """Refuse an argument that is not an instance of one of the given classes."""
    if not isinstance(value, kinds):
        names = " or ".join(kind.__name__ for kind in kinds)
        raise InputError.field(function, name, value, f"of type {names}, not {type(value).__name__}")


def whole(value: Any) -> int | None:
    """Return an integer, Python's or numpy's, as int; None for anything else, also for booleans."""
    try:
        return None if isinstance(value, bool) else operator.index(value)
    except TypeError:
        return None
