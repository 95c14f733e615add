"""How temporary images are framed: resolution, margin around the component, orientation, and plane."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Any, Literal, get_args

import numpy as np

from vaoi_station.errors import InputError
from vaoi_station.rendering.view import Plane

Alignment = Literal["cad", "part"]
"""What is upright in a picture: CAD, or the component as the CAD library draws it, at rotation 0."""

RESOLUTION_LIMITS = (0.1, 1000.0)
"""Smallest and largest resolution of pictures that a caller may request, px/mm."""
MOST_MARGIN_MM = 100.0
"""Largest margin around a component that a caller may request; the limit of pixels is usually reached before."""


@dataclass(frozen=True)
class Framing:
    """How temporary images are framed."""

    px_per_mm: float | None = None
    """Resolution; None for the mean resolution of the cameras."""
    margin_mm: float = 0.0
    """Strip of surroundings on all sides of the component."""
    align: Alignment = "cad"
    plane: Plane = "board"
    """Plane in which the picture is right. Components without a known height are shown in the board's plane."""

    def check(self) -> Framing:
        """Return the framing. Raise InputError if a value is not of its type, or outside its limits."""
        check_number("px_per_mm", self.px_per_mm, *RESOLUTION_LIMITS, optional=True)
        check_number("margin_mm", self.margin_mm, 0.0, MOST_MARGIN_MM)
        check_word("align", self.align, get_args(Alignment))
        check_word("plane", self.plane, get_args(Plane))
        return self


def check_number(name: str, value: object, least: float, most: float, *, optional: bool = False) -> None:
    """Raise InputError unless an option of component images is a number within limits, or None if it is optional."""
    if optional and value is None:
        return
    if not is_number(value) or not least <= value <= most:  # type: ignore[operator]  # it is a number here
        limit = f"{'None or ' if optional else ''}a number from {least:g} to {most:g}"
        raise InputError.field("component images", name, value, limit)


def check_word(name: str, value: object, known: tuple[str, ...]) -> None:
    """Raise InputError unless an option of component images is one of the known words."""
    if value not in known:
        raise InputError.field("component images", name, value, " or ".join(map(repr, known)))


def is_number(value: Any) -> bool:
    """Return whether a value is a number other than NaN; booleans are none."""
    real = isinstance(value, int | float | np.integer | np.floating) and not isinstance(value, bool)
    return real and value == value  # noqa: PLR0124  NaN is the one number that differs from itself
