"""Places in the sentences of an import."""

from __future__ import annotations

from collections.abc import Iterable, Sequence

_SHOWN = 4


def places(points: Iterable[Sequence[float]]) -> str:
    """Return the first places of a list, in mm: `(10, 20), (30, 5) and 3 more`."""
    found = [f"({x:.6g}, {y:.6g})" for x, y in points]
    return ", ".join(found[:_SHOWN]) + (f" and {len(found) - _SHOWN} more" if len(found) > _SHOWN else "")
