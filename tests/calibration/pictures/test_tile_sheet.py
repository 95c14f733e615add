from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.calibration.pictures.tile_sheet import GAP, Picture, arrange_tiles


def tile(grey: int, height: int = 10) -> Picture:
    return np.full((height, 20, 3), grey, np.uint8)


@pytest.mark.parametrize(
    ("count", "columns", "lines"), [(1, 1, 1), (3, 3, 1), (4, 3, 2), (6, 3, 2), (7, 4, 2), (9, 4, 3)]
)
def test_the_number_of_columns_follows_from_the_number_of_tiles(count: int, columns: int, lines: int) -> None:
    sheet = arrange_tiles([tile(7)] * count)
    assert sheet.shape == (lines * 10 + (lines - 1) * GAP, columns * 20 + (columns - 1) * GAP, 3)


def test_tiles_stand_in_reading_order_on_white() -> None:
    sheet = arrange_tiles([tile(k) for k in range(5)])
    assert [sheet[5, x, 0] for x in (10, 38, 66)] == [0, 1, 2]
    assert [sheet[23, x, 0] for x in (10, 38, 66)] == [3, 4, 255]
    assert (sheet[:, 20 : 20 + GAP] == 255).all()
