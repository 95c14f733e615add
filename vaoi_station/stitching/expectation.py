"""Where the board is expected to lie in the first row, and how it is turned."""

from __future__ import annotations

import math
from dataclasses import dataclass


@dataclass(frozen=True)
class Expectation:
    """Prior knowledge of the board's place; by default only that it lies upright, as CAD shows it.

    `angle_rad` is by how much the board, as the cameras see it, is turned from CAD-upright (CAD x to the
    right on the top side, to the left on the bottom side; CAD "up" up), from image x towards image y.
    """

    angle_rad: float = 0.0
    angle_tolerance_rad: float = math.radians(8.0)
    corner_mm: tuple[float | None, float | None] = (None, None)
    """Tester coordinates of the lowest x and y of the board in the first row, where known."""
    tolerance_mm: float = 4.0
