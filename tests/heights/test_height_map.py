"""Maps of heights over a region, and the regions that are refused."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.heights.conftest import ROW_MM, Scene
from vaoi_station.errors import InputError
from vaoi_station.geometry import apply
from vaoi_station.heights.estimates import open_places
from vaoi_station.heights.height_map import draw_map, measure_map


def test_a_map_shows_the_body_and_the_board_beside_it(filmed: Any) -> None:
    places = open_places(filmed.board_type, filmed.stitch, filmed.cameras)
    found = measure_map(places, (-4.0, -2.0, 0.5, 2.0), filmed.frame)
    column, row = np.round(apply(found.image_from_cad, (-2.0, 0.0))).astype(int)
    body = found.height_mm[row - 4 : row + 5, column - 4 : column + 5]
    assert np.nanmedian(body) == pytest.approx(1.5, abs=0.08)
    column, row = np.round(apply(found.image_from_cad, (0.2, 0.0))).astype(int)
    assert np.nanmedian(found.height_mm[row - 4 : row + 5, column - 1 : column + 2]) == pytest.approx(0, abs=0.1)
    known = np.isfinite(found.height_mm)
    assert (np.isfinite(found.sigma_mm) == known).all()
    assert (found.sigma_mm[known] >= 0.019).all()
    assert known.mean() > 0.6
    assert draw_map(found).shape[2] == 3


@pytest.mark.parametrize("mm", [1.0, 0.97])
def test_a_map_of_equal_parts_in_a_row_leaves_out_what_several_heights_explain(film: Any, mm: float) -> None:
    """At 10.84 mm each part falls onto the picture of its neighbour."""
    row = {ref: (box, share, mm) for ref, (box, share, _) in ROW_MM.items()}
    filmed = film(row, rows=2, step_mm=6.0, scene=Scene(alike=True, distance_mm=60.0))
    places = open_places(filmed.board_type, filmed.stitch, filmed.cameras)
    found = measure_map(places, (-1.2, -0.8, 1.2, 0.8), filmed.frame).height_mm
    assert np.isfinite(found).any()
    assert np.nanmax(np.abs(found - mm)) < 0.2


@pytest.mark.parametrize(
    ("region", "said"),
    [
        ((0.0, 0.0, 0.0, 1.0), "two opposite corners"),
        ((-90.0, 0.0, 90.0, 1.0), "at most 80 mm"),
        ((30.0, 30.0, 35.0, 35.0), "must be on the board"),
        ((15.0, 15.0, 17.0, 17.0), "fewer than two frames"),
        ((0.0, 0.0, 0.5, 0.4), "must have at least 12"),
    ],
)
def test_regions_that_cannot_be_measured_are_refused(
    filmed: Any, region: tuple[float, float, float, float], said: str
) -> None:
    places = open_places(filmed.board_type, filmed.stitch, filmed.cameras)
    with pytest.raises(InputError, match=said):
        measure_map(places, region, filmed.frame)
