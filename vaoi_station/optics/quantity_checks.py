"""Checks of quantities before they enter an equation."""

from __future__ import annotations

import math

from vaoi_station.errors import InputError


def require(ok: bool, name: str, value: object, limit: str, where: str = "optics") -> None:
    """Refuse a quantity with its name, value and limit.

    Raises:
        InputError: if `ok` is false.
    """
    if not ok:
        raise InputError.field(where, name, value, limit)


def is_number(value: object) -> bool:
    """Return whether a value is a finite number; booleans and strings are not."""
    # bool is a subclass of int in Python.
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)


def require_positive(where: str = "optics", **quantities: float) -> None:
    """Refuse quantities that are not finite or not above 0; the keywords are their names.

    Raises:
        InputError: for the first quantity that is not.
    """
    for name, value in quantities.items():
        require(is_number(value) and value > 0, name, value, "a finite number above 0", where)


def require_non_negative(where: str = "optics", **quantities: float) -> None:
    """Refuse quantities that are not finite or below 0.

    Raises:
        InputError: for the first quantity that is not.
    """
    for name, value in quantities.items():
        require(is_number(value) and value >= 0, name, value, "a finite number, 0 or above", where)


def ceil_to_whole(value: float) -> int:
    """Return the next whole number; a value that exceeds a whole number only by rounding is not increased."""
    nearest = round(value)
    return nearest if math.isclose(value, nearest, rel_tol=1e-9, abs_tol=1e-9) else math.ceil(value)
