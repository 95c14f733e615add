"""Checks of input quantities of equations. They raise InputError with name, value and limit."""

from __future__ import annotations

import math

from vaoi_station.errors import InputError


def require(ok: bool, name: str, value: object, limit: str, where: str = "optics") -> None:
    """Raise an error with name, value and limit of a quantity unless `ok` is true.

    Raises:
        InputError: if `ok` is false.
    """
    if not ok:
        raise InputError.field(where, name, value, limit)


def is_number(value: object) -> bool:
    """Return whether a value is a finite number. Booleans and strings do not count as numbers."""
    # bool is a subclass of int in Python.
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def require_positive(where: str = "optics", **quantities: float) -> None:
    """Raise an error unless all quantities are finite and above 0. The keywords are the names of the quantities.

    Raises:
        InputError: for the first quantity that is not finite and above 0.
    """
    for name, value in quantities.items():
        require(is_number(value) and value > 0, name, value, "a finite number above 0", where)


def require_non_negative(where: str = "optics", **quantities: float) -> None:
    """Raise an error unless all quantities are finite and at least 0. The keywords are the names of the quantities.

    Raises:
        InputError: for the first quantity that is not finite and at least 0.
    """
    for name, value in quantities.items():
        require(is_number(value) and value >= 0, name, value, "a finite number, 0 or above", where)


def ceil_to_whole(value: float) -> int:
    """Round up to a whole number. A value that exceeds a whole number only by a rounding error is rounded down."""
    nearest = round(value)
    return nearest if math.isclose(value, nearest, rel_tol=1e-9, abs_tol=1e-9) else math.ceil(value)
