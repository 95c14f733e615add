"""Grids of footprints: where they lie, and the frames that show them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.geometry.transforms import apply
from vaoi_station.heights.part_grids import Frames, Places


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


def test_points_of_a_grid_move_with_the_row(filmed: Any) -> None:
    places = Places(filmed.board_type, filmed.stitch, filmed.cameras)
    grid = places.grid("U2", filmed.board_type.footprint(filmed.board_type.component("U2")))
    assert grid is not None
    for (_, row), way in zip(grid.keys.tolist(), places.row_from_grid(grid), strict=True):
        tester = grid.tester_from_grid @ (3.0, 5.0, 1.0)
        np.testing.assert_allclose(way @ (3.0, 5.0, 1.0), apply(filmed.stitch.row_motion[row], tester))


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
