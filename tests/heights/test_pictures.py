"""Pictures of one component: which frames, and where they have values."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.geometry.transforms import apply
from vaoi_station.heights import pictures as resampling
from vaoi_station.heights.pictures import (
    Frames,
    Pictures,
    Places,
    collect_pictures,
    cut_pictures,
    picture_stack,
)


@pytest.fixture(scope="module")
def opened(filmed: Any) -> tuple[Places, Pictures]:
    places = Places(filmed.board_type, filmed.stitch, filmed.cameras)
    grid = places.grid("U1", filmed.board_type.footprint(filmed.board_type.component("U1")))
    assert grid is not None
    pictures = collect_pictures(grid, Frames(filmed.frame), lambda row: row % 2)
    assert pictures is not None
    return places, pictures


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


def test_a_grid_lies_on_the_footprint_and_knows_the_frames_that_show_it(filmed: Any) -> None:
    places, footprint = Places(filmed.board_type, filmed.stitch, filmed.cameras), filmed.board_type.footprint
    camera = filmed.cameras[0]
    for component in filmed.board_type.components:
        grid = places.grid(component.ref, footprint(component))
        assert grid is not None
        corners = apply(filmed.stitch.cad_matrix, footprint(component))
        middle = grid.tester_from_grid @ ((grid.width - 1) / 2, (grid.height - 1) / 2, 1.0)
        np.testing.assert_allclose(middle, corners.mean(0))
        seen = []
        for row, motion in enumerate(filmed.stitch.row_motion):
            px = camera.project(apply(motion, corners))
            if (px.max(0) > 0).all() and (px.min(0) < (camera.width_px, camera.height_px)).all():
                seen.append((0, row))
        assert [tuple(key) for key in grid.keys.tolist()] == seen
        feet = np.column_stack([grid.feet_px, np.ones(len(seen))]) @ grid.tester_from_grid.T
        expected = [apply(np.linalg.inv(filmed.stitch.row_motion[row]), camera.foot_mm) for _, row in seen]
        np.testing.assert_allclose(feet, expected, atol=1e-9)
        np.testing.assert_allclose(grid.distance_mm, camera.working_distance_mm)
    u1 = places.grid("U1", footprint(filmed.board_type.component("U1")))
    assert u1 is not None
    assert (u1.width, u1.height, u1.level) == (60, 50, 0)


def sample(image: np.ndarray, nodes: np.ndarray, step: int, out: np.ndarray) -> None:
    """Sample an image of which the whole is cut out."""
    place = np.array([0, 0, 0, *image.shape[::-1]])
    resampling.sample(image.astype(np.float32).ravel(), place, nodes, step, out)


def mesh(x0: float, y0: float, scale: float) -> np.ndarray:
    x, y = np.meshgrid(x0 + scale * 6 * np.arange(4), y0 + scale * 6 * np.arange(4))
    return np.stack([x, y], -1)


@given(st.floats(-12, 45), st.floats(-12, 45), st.floats(0.2, 3.0), st.booleans())
def test_values_are_those_of_the_kernel_wherever_the_mesh_lies(x0: float, y0: float, scale: float, lost: bool) -> None:
    """Also across the borders of the image, and beside nodes that have no position."""
    image = np.random.default_rng(2).integers(0, 255, (40, 40), dtype=np.uint8)
    nodes = mesh(x0, y0, scale)
    if lost:
        nodes[0, 0] = np.nan
    out = np.empty((18, 18), np.float32)
    sample(image, nodes, 6, out)
    for y, x in ((0, 0), (5, 11), (8, 8), (17, 0), (17, 17)):
        u, v = x0 + scale * x, y0 + scale * y
        near = min(u - 2, v - 2, 37 - u, 37 - v)
        if abs(near) < 1e-9:
            continue  # rounding decides
        if near < 0 or (lost and x < 6 and y < 6):
            assert np.isnan(out[y, x])
            continue
        weights = [np.sinc(t) * np.sinc(t / 3) for t in (np.arange(-2, 4) - (p - int(p)) for p in (u, v))]
        part = image[int(v) - 2 : int(v) + 4, int(u) - 2 : int(u) + 4]
        expected = weights[1] @ part @ weights[0] / (weights[0].sum() * weights[1].sum())
        assert abs(out[y, x] - expected) < 0.5
