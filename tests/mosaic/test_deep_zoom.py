"""Levels and tiles of viewers."""

from __future__ import annotations

from xml.etree import ElementTree

import pytest

from tests.mosaic.conftest import Filmed
from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.mosaic.deep_zoom import (
    dzi_document,
    dzi_reduction,
    iiif_document,
    iiif_tile,
    levels_of,
    tile_box,
)


def test_levels_end_when_one_tile_holds_all(board: Filmed) -> None:
    assert levels_of(board.base) == 3
    assert iiif_document(board.base, "a")["sizes"] == [{"width": 130, "height": 100}]


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


def test_every_listed_tile_of_iiif_is_found(board: Filmed) -> None:
    for factor in iiif_document(board.base, "a")["tiles"][0]["scaleFactors"]:
        side = 256 * factor
        for x in range(0, 520, side):
            for y in range(0, 400, side):
                w, h = min(side, 520 - x), min(side, 400 - y)
                size = f"{-(-w // factor)},{-(-h // factor)}"
                reduction, box = iiif_tile(board.base, f"{x},{y},{w},{h}", size)
                assert reduction == factor
                assert (box[0] * factor, box[1] * factor) == (x, y)


@pytest.mark.parametrize(
    ("region", "size"),
    [("0,0,100,100", "max"), ("full", "520,400"), ("0,0,256,256", "128,128"), ("pct:1,1,1,1", "max")],
)
def test_other_parts_are_refused(board: Filmed, region: str, size: str) -> None:
    with pytest.raises(InputError, match=r"one of the tiles and sizes of info\.json"):
        iiif_tile(board.base, region, size)
