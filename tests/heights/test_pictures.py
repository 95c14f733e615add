"""Pictures of one component: which frames, and where they have values."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from vaoi_station.geometry.transforms import apply
from vaoi_station.heights.part_grids import Frames, Places
from vaoi_station.heights.pictures import Pictures, collect_pictures, cut_pictures, picture_stack, surface_stack


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
    assert len(pictures.images) == len(pictures.grid.keys) >= 2
    assert pictures.group.tolist() == (pictures.grid.keys[:, 1] % 2).tolist()
    assert pictures.spread > 0


def test_a_single_frame_shows_no_parallax(opened: tuple[Places, Pictures], filmed: Any) -> None:
    first = tuple(opened[1].grid.keys[0].tolist())
    frames = Frames(lambda i, j: filmed.frame(i, j) if (i, j) == first else None)
    assert collect_pictures(opened[1].grid, frames, lambda row: 0) is None


def test_on_the_plane_of_a_body_its_pictures_are_equal(opened: tuple[Places, Pictures]) -> None:
    places, pictures = opened
    two = pictures.grid.keys[:, 1].tolist().index(1), pictures.grid.keys[:, 1].tolist().index(2)
    cut = cut_pictures(places, pictures, 0.0, 2.0)

    def differences(height_mm: float) -> float:
        stack = picture_stack(places, pictures, cut, 0, height_mm)
        return float(np.nanstd((stack[two[0]] - stack[two[1]])[4:-4, 4:-4]))

    assert 2 * differences(1.5) < differences(0.0)


def test_pictures_are_those_of_exact_positions_blurred(opened: tuple[Places, Pictures], filmed: Any) -> None:
    places, pictures = opened
    grid, margin, height_mm = pictures.grid, 2, 0.7
    stack = picture_stack(places, pictures, cut_pictures(places, pictures, 0.0, 2.0), margin, height_mm)
    y, x = np.mgrid[-margin : grid.height + margin, -margin : grid.width + margin].astype(np.float64)
    tester = np.stack([x, y, np.ones_like(x)], -1) @ grid.tester_from_grid.T
    for n, (camera, row) in enumerate(grid.keys.tolist()):
        at = filmed.cameras[camera].project(apply(filmed.stitch.row_motion[row], tester), height_mm)
        image = filmed.frames[camera, row].astype(np.float32)
        u, v = np.moveaxis(at.astype(np.float32), -1, 0)
        sharp = cv2.remap(image, u, v, cv2.INTER_LANCZOS4)
        known = np.isfinite(stack[n])
        # A kernel of 8×8 pixels, not 6×6, and positions that are rounded to 1/32 px.
        error = (stack[n] - cv2.GaussianBlur(sharp, (11, 11), 1.1))[known]
        assert np.sqrt((error**2).mean()) < 0.6
        assert abs(error.mean()) < 0.1


def test_the_sweep_reads_the_same_values_as_without_limits(opened: tuple[Places, Pictures]) -> None:
    places, pictures = opened
    cut = cut_pictures(places, pictures, 0.0, 5.0)
    limited, margin = surface_stack(places, pictures, cut)
    everywhere = picture_stack(places, pictures, cut, margin, 0.0)
    assert limited.shape == everywhere.shape
    assert np.isfinite(limited).sum() < np.isfinite(everywhere).sum()
    # The footprint is read at the least, and beside it what the height moves there.
    inner = slice(margin, -margin)
    np.testing.assert_allclose(limited[:, inner, inner], everywhere[:, inner, inner], atol=0.05)


def test_outside_the_frame_there_are_no_values(opened: tuple[Places, Pictures]) -> None:
    places, pictures = opened
    picture = picture_stack(places, pictures, cut_pictures(places, pictures, 0.0, 2.0), 300, 0.0)[0]
    assert np.isnan(picture[0, 0])
    assert np.isfinite(picture).any()
