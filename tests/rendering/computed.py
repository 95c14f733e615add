"""The views of one component of a run."""

from __future__ import annotations

from collections.abc import Sequence
from typing import Any

from vaoi_station.geometry import Camera
from vaoi_station.model import BoardType, Component, Stitch
from vaoi_station.rendering import View, ViewCalculator


def compute_views(
    component: Component, board_type: BoardType, stitch: Stitch, cameras: Sequence[Camera], **options: Any
) -> tuple[View, ...]:
    """Compute the views of one component alone."""
    return ViewCalculator(board_type, stitch, cameras).compute(component, **options)
