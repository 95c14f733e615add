"""Comparison of measured heights with those that the board type expects: data, not a verdict."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal

from vaoi_station.heights.estimates import PartHeight
from vaoi_station.model import BoardType

Comparison = Literal["agrees", "lower", "higher", "unknown"]
TOLERANCE_MM, TOLERANCE_SHARE = 0.1, 0.1
"""A body may differ from its expected height by this, or by this share of it, whichever is larger."""
_LEAST = 0.95
"""Least probability of a statement other than "unknown"."""


def compare(height: PartHeight, expected_mm: float) -> tuple[Comparison, float]:
    """Compare a height with the expected one; return the most probable statement and its probability.

    The statement is "unknown" if none has a probability of at least 0.95; the probability is that of the best one.
    """
    tolerance = max(TOLERANCE_MM, TOLERANCE_SHARE * expected_mm)
    lower = _below(height, expected_mm - tolerance)
    higher = 1 - _below(height, expected_mm + tolerance)
    chances: dict[Comparison, float] = {"agrees": max(0.0, 1 - lower - higher), "lower": lower, "higher": higher}
    best = max(chances, key=lambda name: chances[name])
    return (best if chances[best] >= _LEAST else "unknown"), chances[best]


def _below(height: PartHeight, limit_mm: float) -> float:
    """Return the probability that a height is below a limit."""
    if height.height_mm is not None and height.sigma_mm is not None:
        return math.erfc((height.height_mm - limit_mm) / height.sigma_mm / math.sqrt(2)) / 2
    if height.low_mm is not None and height.high_mm is not None:
        return min(max((limit_mm - height.low_mm) / max(height.high_mm - height.low_mm, 1e-9), 0.0), 1.0)
    return 0.5


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
            entry |= {"low_mm": _rounded(found.low_mm), "high_mm": _rounded(found.high_mm)}
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
