"""The grid of a mosaic: upright, never mirrored, and refused with numbers where it cannot be."""

from __future__ import annotations

from typing import Any

import pytest

from vaoi_station.errors import InputError
from vaoi_station.geometry import apply
from vaoi_station.model import BoardType
from vaoi_station.mosaic.grid import (
    MosaicGrid,
)


def board_type(**keys: Any) -> BoardType:
    return BoardType.model_validate({"name": "b", "outline": [[10, 20], [50, 50]], **keys})


@pytest.mark.parametrize(
    ("keys", "first", "last"),
    [
        ({}, (10, 50), (50, 20)),
        ({"y_axis": "down"}, (10, 20), (50, 50)),
        ({"side": "bottom"}, (50, 50), (10, 20)),
    ],
)
def test_corners_lie_on_the_outer_edges_of_the_border_pixels(keys: Any, first: Any, last: Any) -> None:
    grid = MosaicGrid.of_board(board_type(**keys), 10.0)
    assert (grid.width, grid.height) == (400, 300)
    assert apply(grid.mosaic_from_cad, first) == pytest.approx((-0.5, -0.5))
    assert apply(grid.mosaic_from_cad, last) == pytest.approx((399.5, 299.5))
    assert apply(grid.cad_from_mosaic, (-0.5, -0.5)) == pytest.approx(first)


@pytest.mark.parametrize("region", [(0, 20, 30, 40), (10, 20, 60, 50), (200, 200, 210, 210)])
def test_region_off_the_board_is_refused_with_the_boards_extent(region: Any) -> None:
    with pytest.raises(InputError, match=r"region is '.*', .*\(10, 20\) to \(50, 50\) mm, or at most 5 mm beside it"):
        MosaicGrid.of_board(board_type(), 10.0, region)


def test_too_large_a_mosaic_is_refused_with_its_size() -> None:
    with pytest.raises(InputError, match=r"px_per_mm is 950.0, .* 1000 megapixels \(this would be 38000×28500\)"):
        MosaicGrid.of_board(board_type(), 950.0)
    with pytest.raises(InputError, match=r"px_per_mm is 0\.01, but must be a number from 0\.1 to 1000"):
        MosaicGrid.of_board(board_type(), 0.01)
