"""Comparison of measured heights with those that the board type expects: data, not a verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal

from vaoi_station.heights.estimates import Interval, PartHeight
from vaoi_station.model import BoardType

Comparison = Literal["agrees", "lower", "higher", "ambiguous", "unknown"]
TOLERANCE_MM, TOLERANCE_SHARE = 0.1, 0.1
"""A body may differ from its expected height by this, or by this share of it, whichever is larger."""
_LEAST, _LEAST_OTHER = 0.95, 0.995
"""Least probability of "agrees", and of "lower" and "higher": few bodies are other than expected."""

_EDGE = 0.1
"""Uncertainty of the ends of an interval, as a share of its width: the pictures fall off slowly there."""
_WIDE, _WIDER = 0.03, 5.0
"""Share of the heights that err more than their standard deviation says, and the factor by which it is too small."""


def compare(height: PartHeight, expected_mm: float) -> tuple[Comparison, float]:
    """Compare a height with the expected one; return the most probable statement and its probability.

    The statement is "ambiguous" or "unknown" if none is probable enough: several intervals are left, or one, or
    nothing is known. The probability is that of the most probable one of the others. The expected height has no part in
    it, and an interval counts only for what all of it says.
    """
    tolerance = max(TOLERANCE_MM, TOLERANCE_SHARE * expected_mm)
    low, high = expected_mm - tolerance, expected_mm + tolerance
    if height.height_mm is not None and height.sigma_mm is not None:
        lower = _beyond(height.height_mm - low, height.sigma_mm)
        higher = _beyond(high - height.height_mm, height.sigma_mm)
        agrees = max(0.0, 1 - lower - higher)
    else:
        lower = sum(i.probability for i in height.intervals if i.high_mm + _edge_mm(i) <= low)
        higher = sum(i.probability for i in height.intervals if i.low_mm - _edge_mm(i) >= high)
        agrees = sum(i.probability for i in height.intervals if low <= i.low_mm and i.high_mm <= high)
    chances: dict[Comparison, float] = {"agrees": agrees, "lower": lower, "higher": higher}
    best = max(chances, key=lambda name: chances[name])
    if chances[best] >= (_LEAST if best == "agrees" else _LEAST_OTHER):
        return best, chances[best]
    return ("ambiguous" if len(height.intervals) > 1 else "unknown"), chances[best]


def _edge_mm(interval: Interval) -> float:
    """Return how uncertain the ends of an interval are, mm."""
    return _EDGE * (interval.high_mm - interval.low_mm)


def _beyond(distance_mm: float, sigma_mm: float) -> float:
    """Return the probability that a height errs by more than a distance."""
    z = distance_mm / (sigma_mm * math.sqrt(2))
    return ((1 - _WIDE) * math.erfc(z) + _WIDE * math.erfc(z / _WIDER)) / 2


def heights_document(heights: Mapping[str, PartHeight], board_type: BoardType) -> dict[str, dict[str, Any]]:
    """Return the heights as they are written to files and served: one object per component, by address."""
    out = {}
    for component in board_type.components:
        found = heights.get(component.address)
        if found is None:
            continue
        entry: dict[str, Any] = {
            "height_mm": _rounded(found.height_mm),
            "sigma_mm": _rounded(found.sigma_mm),
            "views": found.views,
        }
        if found.height_mm is None:
            entry |= {
                "low_mm": _rounded(found.intervals[0].low_mm) if found.intervals else None,
                "high_mm": _rounded(found.intervals[-1].high_mm) if found.intervals else None,
            }
        if len(found.intervals) > 1:
            entry["intervals"] = [{k: _rounded(v) for k, v in i._asdict().items()} for i in found.intervals]
        if component.body_height is not None:
            expected = component.body_height * board_type.mm_per_unit
            statement, probability = compare(found, expected)
            entry |= {
                "expected_mm": _rounded(expected),
                "comparison": statement,
                "probability": _rounded(probability),
            }
        out[component.address] = entry
    return out


def _rounded(value: float | None) -> float | None:
    return None if value is None else round(value, 4)
