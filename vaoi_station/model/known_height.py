"""The height at which a component's top is taken to lie when frames are laid over one another."""

from __future__ import annotations

import math

from vaoi_station.model.board_type import BoardType, Component
from vaoi_station.model.stitch_result import Stitch

_SIGMAS = 3.0
"""A measured height counts if it is at least this many standard deviations above the board."""
_MOST_SIGMA_MM = 0.2


def known_height_mm(component: Component, board_type: BoardType, stitch: Stitch) -> float:
    """Return the height of a component's top above the board: that of its CAD data, else the measured one, else 0."""
    if component.body_height is not None:
        return component.body_height * board_type.mm_per_unit
    figures = (stitch.quality.get(key) or {} for key in ("heights_mm", "height_sigma_mm"))
    height, sigma = (figure.get(component.address, math.nan) for figure in figures)
    if not _is_number(height) or not _is_number(sigma):
        return 0.0
    sure = float(sigma) <= _MOST_SIGMA_MM and float(height) > _SIGMAS * float(sigma)
    return float(height) if sure else 0.0


def _is_number(value: object) -> bool:
    return isinstance(value, int | float) and not isinstance(value, bool) and math.isfinite(value)
