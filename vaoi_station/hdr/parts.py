"""What is merged: a component on the plane of its top, or a region of the board; and the plane's height."""

from __future__ import annotations

import math
from collections.abc import Sequence

from vaoi_station.errors import InputError
from vaoi_station.model import BoardType, Component
from vaoi_station.rendering import Framing, View, ViewCalculator
from vaoi_station.rendering.crops import MOST_PIXELS

REGION = "region"
"""Name of the picture of a region."""
LEAST_COVERAGE = 0.02
"""Least share of a component that a frame must show to be merged, if the caller does not choose another."""


def views_on_top(
    calculator: ViewCalculator,
    component: Component,
    height_mm: float,
    *,
    px_per_mm: float | None = None,
    min_coverage: float | None = None,
) -> tuple[View, ...]:
    """Compute the views of a component in the plane of its top, in which its body lies still from view to view.

    Args:
        calculator: calculator of the run's views.
        component: a component of the board type, or a region (`region_component`).
        height_mm: height of its top above the board; 0 for the plane of the board.
        px_per_mm: resolution; None for that of the cameras.
        min_coverage: least share of the component in a frame; None for hardly any, since frames complement each other.
    """
    least = LEAST_COVERAGE if min_coverage is None else max(min_coverage, 1e-9)
    return calculator.compute(
        component,
        px_per_mm=px_per_mm,
        min_coverage=least,
        framing=Framing(plane="top") if height_mm else None,
        height_mm=height_mm or None,
    )


def region_component(
    corners: Sequence[float], board_type: BoardType, px_per_mm: float, where: str = "--region"
) -> Component:
    """Return a region of the board as a component without a body.

    Args:
        corners: x0, y0, x1, y1 in CAD coordinates.
        board_type: board type of the run.
        px_per_mm: resolution of the picture.
        where: how the caller names the region, for messages.

    Raises:
        InputError: the region has no area, does not touch the board, or is too large.
    """
    x0, y0, x1, y1 = (float(v) for v in corners)
    shown, unit = f"{x0:g} {y0:g} {x1:g} {y1:g}", board_type.unit
    if not all(map(math.isfinite, (x0, y0, x1, y1))) or x0 >= x1 or y0 >= y1:
        raise InputError.field(
            where, "X0 Y0 X1 Y1", shown, f"numbers with X0 < X1 and Y0 < Y1, in CAD coordinates ({unit})"
        )
    low, high = (corner.tolist() for corner in board_type.extent())
    if x1 <= low[0] or y1 <= low[1] or x0 >= high[0] or y0 >= high[1]:
        raise InputError.field(
            where,
            "X0 Y0 X1 Y1",
            shown,
            f"on the board, which reaches from {low[0]:g} {low[1]:g} to {high[0]:g} {high[1]:g} ({unit}, CAD)",
        )
    mm = board_type.mm_per_unit
    pixels = (x1 - x0) * (y1 - y0) * (mm * px_per_mm) ** 2
    if pixels > MOST_PIXELS:
        most = px_per_mm * math.sqrt(MOST_PIXELS / pixels)
        raise InputError(
            f"{where}: {shown} is {(x1 - x0) * mm:.1f} × {(y1 - y0) * mm:.1f} mm, {pixels / 1e6:.0f} megapixels at "
            f"{px_per_mm:.4g} px/mm, but the limit is {MOST_PIXELS / 1e6:.0f}.",
            action=f"Ask for a smaller region, or for at most {math.floor(most * 10) / 10:g} px/mm.",
        )
    return Component(ref=REGION, center=((x0 + x1) / 2, (y0 + y1) / 2), width=x1 - x0, height=y1 - y0)
