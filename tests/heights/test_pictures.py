"""Pictures of one component: which frames, and where they have values."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.heights.part_grids import Frames, Places
from vaoi_station.heights.pictures import Pictures, collect_pictures, picture_stack, sweep_stack


@pytest.fixture(scope="module")
def opened(filmed: Any) -> tuple[Places, Pictures]:
    places = Places(filmed.board_type, filmed.stitch, filmed.cameras)
    grid = places.grid("U1", filmed.board_type.footprint(filmed.board_type.component("U1")))
    assert grid is not None
    pictures = collect_pictures(grid, Frames(filmed.frame), lambda row: row % 2)
    assert pictures is not None
    return places, pictures


def test_every_frame_that_shows_the_part_is_collected_with_its_light(opened: tuple[Places, Pictures]) -> None:
    _, pictures = opened
    assert len(pictures.images) == len(pictures.grid.views) >= 2
    assert pictures.group.tolist() == [view.key[1] % 2 for view in pictures.grid.views]
    assert pictures.spread > 0


def test_a_single_frame_shows_no_parallax(opened: tuple[Places, Pictures], filmed: Any) -> None:
    first = opened[1].grid.views[0].key
    frames = Frames(lambda i, j: filmed.frame(i, j) if (i, j) == first else None)
    assert collect_pictures(opened[1].grid, frames, lambda row: 0) is None


def test_the_sweep_reads_the_same_values_as_without_limits(opened: tuple[Places, Pictures]) -> None:
    places, pictures = opened
    ends = np.array([[0.0], [5.0]]) / pictures.distance_mm
    limited, everywhere = sweep_stack(places, pictures, 20, ends), picture_stack(places, pictures, 20, 0.0)
    assert limited.shape == everywhere.shape
    assert np.isfinite(limited).sum() < np.isfinite(everywhere).sum()
    # Two pixels beside the footprint are read at the least, further ones where the height moves it.
    inner = slice(18, -18)
    np.testing.assert_allclose(limited[:, inner, inner], everywhere[:, inner, inner], atol=0.05)
