"""Constraints of a plan: inequalities between a computed value and a limit, with their margins."""

from __future__ import annotations

from dataclasses import dataclass
from typing import Literal

_ROUNDING = 1e-9
"""Largest relative difference between value and limit that counts as equality."""


@dataclass(frozen=True)
class Constraint:
    """The inequality `value relation limit`. Its margin is negative if it is violated. All three are in `unit`."""

    name: str
    equation: str
    """The inequality as the paper writes it, with its equation number if it has one."""
    value: float | None
    relation: Literal["≤", "≥"]
    limit: float | None
    margin: float | None
    unit: str
    ok: bool | None
    """Whether the constraint is satisfied; None if a missing quantity, which `note` names, prevents the check."""
    note: str = ""
    missing: tuple[str, ...] = ()
    """Requirements that are not given and would make the check possible; empty if it was made."""


def at_most(name: str, equation: str, value: float, limit: float, *, unit: str, note: str = "") -> Constraint:
    """Create the constraint `value ≤ limit`."""
    margin = _without_rounding(limit - value, limit)
    return Constraint(name, equation, value, "≤", limit, margin, unit, margin >= 0, note)


def at_least(name: str, equation: str, value: float, limit: float, *, unit: str, note: str = "") -> Constraint:
    """Create the constraint `value ≥ limit`."""
    margin = _without_rounding(value - limit, limit)
    return Constraint(name, equation, value, "≥", limit, margin, unit, margin >= 0, note)


def not_checked(
    name: str,
    equation: str,
    relation: Literal["≤", "≥"],
    *,
    unit: str,
    note: str,
    missing: tuple[str, ...],
    value: float | None = None,
) -> Constraint:
    """Create a constraint that cannot be checked because the requirements `missing` are; `note` says it in words."""
    return Constraint(name, equation, value, relation, None, None, unit, None, note, missing)


def _without_rounding(margin: float, limit: float) -> float:
    # A plan may choose the limit itself as the value, such as the longest exposure. A rounding error must not make it
    # fail.
    return 0.0 if abs(margin) <= _ROUNDING * abs(limit) else margin
