"""One thing a plan must satisfy, with its margin."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

_ROUNDING = 1e-9


@dataclass(frozen=True)
class Constraint:
    """`value relation limit`, in `unit`; the margin is what is left, negative where it is violated."""

    name: str
    equation: str
    """As the paper writes it, with its number where it has one."""
    value: float | None
    relation: Literal["≤", "≥"]
    limit: float | None
    margin: float | None
    unit: str
    ok: bool | None
    """None where it cannot be judged; the note says what is missing."""
    note: str = ""


def at_most(name: str, equation: str, value: float, limit: float, *, unit: str, note: str = "") -> Constraint:
    """`value ≤ limit`; a difference of rounding only counts as equality."""
    margin = _without_rounding(limit - value, limit)
    return Constraint(name, equation, value, "≤", limit, margin, unit, margin >= 0, note)


def at_least(name: str, equation: str, value: float, limit: float, *, unit: str, note: str = "") -> Constraint:
    """`value ≥ limit`; a difference of rounding only counts as equality."""
    margin = _without_rounding(value - limit, limit)
    return Constraint(name, equation, value, "≥", limit, margin, unit, margin >= 0, note)


def not_checked(
    name: str, equation: str, relation: Literal["≤", "≥"], *, unit: str, note: str, value: float | None = None
) -> Constraint:
    """A constraint for which a quantity is missing; `note` says which."""
    return Constraint(name, equation, value, relation, None, None, unit, None, note)


def _without_rounding(margin: float, limit: float) -> float:
    return 0.0 if abs(margin) <= _ROUNDING * abs(limit) else margin
