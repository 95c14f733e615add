from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.errors import InputError
from vaoi_station.hdr.parts import region_component, views_on_top
from vaoi_station.model import BoardType, Component
from vaoi_station.rendering import ViewCalculator


def board(**options: Any) -> BoardType:
    data = {"name": "b", "outline": [[0, 0], [40, 30]], "fiducials": []}
    return BoardType.model_validate(data | options)


def test_a_region_is_a_component_of_its_size() -> None:
    part = region_component((2, 3, 12, 8), board(), 40.0)
    assert (part.center, part.width, part.height) == ((7.0, 5.5), 10.0, 5.0)


@pytest.mark.parametrize(
    ("corners", "px_per_mm", "message"),
    [
        ((5, 5, 5, 9), 40.0, "X0 Y0 X1 Y1 is '5 5 5 9', but must be numbers with X0 < X1 and Y0 < Y1"),
        ((5, 5, float("nan"), 9), 40.0, "X0 < X1"),
        ((41, 5, 50, 9), 40.0, r"must be on the board, which reaches from 0 0 to 40 30 \(mm, CAD\)"),
        ((0, 0, 40, 30), 200.0, r"40.0 × 30.0 mm, 48 megapixels at 200 px/mm, but the limit is 16.* 115.4 px/mm"),
    ],
)
def test_regions_off_the_board_or_too_large_are_refused(corners: Any, px_per_mm: float, message: str) -> None:
    with pytest.raises(InputError, match=message):
        region_component(corners, board(), px_per_mm)


def test_views_lie_in_the_plane_of_the_top(small_views: tuple[ViewCalculator, Component]) -> None:
    calculator, part = small_views
    low, high = (views_on_top(calculator, part, h, min_coverage=0.5) for h in (0.0, 2.0))
    assert {v.plane for v in low} == {"board"}
    assert {(v.plane, v.height_mm) for v in high} == {("top", 2.0)}
    assert len(views_on_top(calculator, part, 0.0)) >= len(low)
    shifts = [np.abs(a.matrix - b.matrix).max() for a, b in zip(low, high, strict=False)]
    assert max(shifts) > 0.5
