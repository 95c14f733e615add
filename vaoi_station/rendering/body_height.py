"""The height of a component's body, at which a temporary image can lie instead of on the board."""

from __future__ import annotations

import math
from typing import Any, Literal, NamedTuple

from vaoi_station.model import BoardType, Component, Stitch


class BodyHeight(NamedTuple):
    """The height of a body above the board's surface."""

    mm: float
    sigma_mm: float | None
    """Standard deviation of a measured height; None for a height of the board type, whose tolerance is not known."""
    source: Literal["measured", "board-type"]


def body_height(part: Component, board_type: BoardType, result: Stitch) -> BodyHeight | None:
    """Return the height that the run measured, else the `body_height` of the board type; None if there is neither."""
    measured = _figure(result.quality.get("heights_mm"), part.address)
    if measured is not None:
        return BodyHeight(measured, _figure(result.quality.get("height_sigma_mm"), part.address), "measured")
    if part.body_height is None:
        return None
    return BodyHeight(part.body_height * board_type.mm_per_unit, None, "board-type")


def plane_remark(part: Component, height: BodyHeight | None, cameras_know: bool) -> str | None:
    """Return why images that were requested in the plane of the body's top lie on the board; None if they do not.

    `cameras_know` is whether the calibration states the working distance of the cameras.
    """
    if not cameras_know:
        return (
            "The calibration states no working_distance_mm, so a height has no known effect: the images are right in "
            "the plane of the board."
        )
    if height is None:
        return (
            f"{part.address} has no height: the run measured none, and the board type states no body_height. Its "
            "images are right in the plane of the board."
        )
    return None


def _figure(figures: Any, ref: str) -> float | None:
    # `quality` accepts any keys and values, so that readers of older versions can open newer results.
    value = figures.get(ref) if isinstance(figures, dict) else None
    if isinstance(value, bool) or not isinstance(value, int | float) or not math.isfinite(value):
        return None
    return float(value)
