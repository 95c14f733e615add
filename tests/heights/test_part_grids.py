"""Grids of footprints: the frames that show them, and pictures on a plane at a height."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.heights.part_grids import Frames, Places


def test_pictures_on_the_plane_of_a_body_are_equal(filmed: Any) -> None:
    places, frames = Places(filmed.board_type, filmed.stitch, filmed.cameras), Frames(filmed.frame)
    grid = places.grid("U1", filmed.board_type.footprint(filmed.board_type.component("U1")))
    assert grid is not None
    assert (grid.width, grid.height, grid.level) == (60, 50, 0)
    views = [view for view in grid.views if view.key[1] in {1, 2}]

    def differences(height_mm: float) -> float:
        images = [image for v in views if (image := frames.get(v.key, 0)) is not None]
        pictures = places.rectified(grid._replace(views=tuple(views)), images, 0, height_mm)
        return float(np.nanstd((pictures[0] - pictures[1])[4:-4, 4:-4]))

    assert 2 * differences(1.5) < differences(0.0)


def test_outside_the_frame_there_are_no_values(filmed: Any) -> None:
    places, frames = Places(filmed.board_type, filmed.stitch, filmed.cameras), Frames(filmed.frame)
    grid = places.grid("U1", filmed.board_type.footprint(filmed.board_type.component("U1")))
    assert grid is not None
    image = frames.get(grid.views[0].key, 0)
    assert image is not None
    picture = places.rectified(grid._replace(views=grid.views[:1]), [image], 300)[0]
    assert np.isnan(picture[0, 0])
    assert np.isfinite(picture).any()


def test_a_box_and_all_views_at_once_have_the_same_pixels(filmed: Any) -> None:
    """One view after the other, and all of them, of which some belong to other cameras."""
    places, frames = Places(filmed.board_type, filmed.stitch, filmed.cameras), Frames(filmed.frame)
    grid = places.grid("U1", filmed.board_type.footprint(filmed.board_type.component("U1")))
    assert grid is not None
    images = [image for v in grid.views if (image := frames.get(v.key, 0)) is not None]
    together = places.rectified(grid, images, 2)
    assert together.shape == (len(grid.views), grid.height + 4, grid.width + 4)
    for view, image, picture in zip(grid.views, images, together, strict=True):
        alone = places.rectified_box(grid, view, image, (-2, -2, grid.width + 2, grid.height + 2))
        np.testing.assert_allclose(picture, alone, atol=1e-3)


def test_large_footprints_have_larger_pixels_and_tiny_ones_no_grid(filmed: Any) -> None:
    places = Places(filmed.board_type, filmed.stitch, filmed.cameras)
    box = np.array([[-1, -1], [1, -1], [1, 1], [-1, 1]])
    large = places.grid("X", box * 8.0)
    assert large is not None
    assert large.level == 1
    assert large.mm_per_px == pytest.approx(0.1)
    assert places.grid("X", box * 0.1) is None


def test_frames_are_reduced_by_block_means_and_missing_ones_stay_missing() -> None:
    image = np.arange(64, dtype=np.uint8).reshape(8, 8)
    frames = Frames(lambda i, j: image if j == 0 else None)
    reduced = frames.get((0, 0), 1)
    assert reduced is not None
    assert reduced.shape == (4, 4)
    assert abs(float(reduced[0, 0]) - image[:2, :2].mean()) <= 0.5
    assert frames.get((0, 1), 1) is None
