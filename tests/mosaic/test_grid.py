"""The grid of a mosaic: upright, never mirrored, and refused with numbers where it cannot be."""

from __future__ import annotations

from typing import Any
from xml.etree import ElementTree

import pytest

from tests.mosaic.conftest import Filmed
from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.geometry import apply
from vaoi_station.model import BoardType
from vaoi_station.mosaic.grid import (
    MosaicGrid,
    dzi_document,
    dzi_reduction,
    tile_box,
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


def test_reduced_grid_has_the_same_first_corner() -> None:
    grid = MosaicGrid.of_board(board_type(y_axis="down"), 10.0).reduced(4)
    assert (grid.width, grid.height) == (100, 75)
    assert apply(grid.mosaic_from_cad, (10, 20)) == pytest.approx((-0.5, -0.5))


def test_region_is_given_by_any_two_opposite_corners() -> None:
    grid = MosaicGrid.of_board(board_type(y_axis="down"), 10.0, (30, 40, 20, 25))
    assert (grid.width, grid.height) == (100, 150)
    assert apply(grid.mosaic_from_cad, (20, 25)) == pytest.approx((-0.5, -0.5))


@pytest.mark.parametrize("region", [(0, 20, 30, 40), (10, 20, 60, 50), (200, 200, 210, 210)])
def test_region_off_the_board_is_refused_with_the_boards_extent(region: Any) -> None:
    with pytest.raises(InputError, match=r"region is '.*', .*\(10, 20\) to \(50, 50\) mm, or at most 5 mm beside it"):
        MosaicGrid.of_board(board_type(), 10.0, region)


@pytest.mark.parametrize("region", [(20, 20, 20, 40), (20, 20, float("nan"), 40)])
def test_region_without_area_is_refused(region: Any) -> None:
    with pytest.raises(InputError, match="two opposite corners"):
        MosaicGrid.of_board(board_type(), 10.0, region)


def test_too_large_a_mosaic_is_refused_with_its_size() -> None:
    with pytest.raises(InputError, match=r"px_per_mm is 950.0, .* 1000 megapixels \(this would be 38000×28500\)"):
        MosaicGrid.of_board(board_type(), 950.0)
    with pytest.raises(InputError, match=r"px_per_mm is 0\.01, but must be a number from 0\.1 to 1000"):
        MosaicGrid.of_board(board_type(), 0.01)


def test_levels_of_dzi_count_from_one_pixel(board: Filmed) -> None:
    assert [dzi_reduction(board.base, k) for k in (0, 9, 10)] == [1024, 2, 1]
    with pytest.raises(NotFoundError, match="levels 0 to 10; there is no level 11"):
        dzi_reduction(board.base, 11)
    document = ElementTree.fromstring(dzi_document(board.base, "jpg"))
    assert document.attrib["Format"] == "jpg"


def test_tiles_at_the_end_are_smaller(board: Filmed) -> None:
    assert tile_box(board.base, 2, 1) == (512, 256, 520, 400)
    with pytest.raises(NotFoundError, match="3×2 tiles"):
        tile_box(board.base, 3, 0)
