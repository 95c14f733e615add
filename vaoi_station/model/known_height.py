"""The height at which a component's top is taken to lie: by top-plane pictures, by merged pictures and by mosaics."""

from __future__ import annotations

import math
from collections.abc import Mapping
from typing import Any, Literal, NamedTuple

from vaoi_station.model.board_type import BoardType, Component
from vaoi_station.model.stitch_result import Stitch

_SIGMAS = 3.0
"""A measured top that is less than this many standard deviations above the board is taken to lie on it."""
_MOST_SIGMA_MM = 0.2
"""Largest standard deviation of a measured height that counts more than the height of the board type."""

Heights = Mapping[str, tuple[float, float]]
"""Measured heights of components and their standard deviations, mm, by address."""


class BodyHeight(NamedTuple):
    """The height of a body above the board's surface."""

    mm: float
    sigma_mm: float | None
    """Standard deviation of a measured height; None for a height of the board type, whose tolerance is not known."""
    source: Literal["measured", "board-type"]


def body_height(part: Component, board_type: BoardType, result: Stitch) -> BodyHeight | None:
    """Return the height of a component's body; None if it is neither measured nor stated by the board type.

    A board may have another part than its CAD data state, or none, so a sure measurement comes before the board type,
    and an unsure one after it.
    """
    height, sigma = (_figure(result.quality.get(key), part.address) for key in ("heights_mm", "height_sigma_mm"))
    measured = None if height is None or sigma is None else BodyHeight(height, sigma, "measured")
    if part.body_height is None or (sigma is not None and sigma <= _MOST_SIGMA_MM and measured is not None):
        return measured
    return BodyHeight(part.body_height * board_type.mm_per_unit, None, "board-type")


def known_height_mm(part: Component, board_type: BoardType, result: Stitch) -> float:
    """Return the height of a component's top above the board; 0 if none is known, or the top may lie on the board."""
    height = body_height(part, board_type, result)
    if height is None or height.mm <= _SIGMAS * (height.sigma_mm or 0.0):
        return 0.0
    return height.mm


def with_heights(result: Stitch, heights_mm: Heights) -> Stitch:
    """Return a result with heights measured from all frames in place of those that follow from its links."""
    if not heights_mm:
        return result
    columns = {"heights_mm": 0, "height_sigma_mm": 1}
    changed = {}
    for key, column in columns.items():
        table = result.quality.get(key)
        own = table if isinstance(table, dict) else {}
        changed[key] = {**own, **{ref: values[column] for ref, values in heights_mm.items()}}
    return result.model_copy(update={"quality": {**result.quality, **changed}})


def _figure(figures: Any, ref: str) -> float | None:
    # `quality` accepts any keys and values, so that readers of older versions can open newer results.
    value = figures.get(ref) if isinstance(figures, dict) else None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)
