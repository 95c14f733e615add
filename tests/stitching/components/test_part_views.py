"""The most central views of components, and the patches around them."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.geometry import apply
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.motion import nominal_motion
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.components.centres import central_views, reduced_patch, reduction
from vaoi_station.stitching.geometry import FootprintViews
from vaoi_station.stitching.matching.frames import Scene


def test_each_component_is_taken_from_the_good_frame_that_shows_it_most_central(workshop: Any) -> None:
    """The board moves by 4 mm from row to row; row 1 did not arrive."""
    parts = [{"ref": f"R{n}", "center": [2.0 + 4 * n, 3.0], "width": 2.0, "height": 1.0} for n in range(4)]
    plane = BoardPlane(BoardType.model_validate({"name": "b", "y_axis": "down", "components": parts}), mirrored=False)
    camera = workshop.camera((0.0, 0.0), size_px=(480, 320), px_per_mm=15.0)
    rows = np.arange(4.0)
    motion = nominal_motion(rows, np.array([-4.0, 0.0]), np.zeros(2))
    views = FootprintViews.of(plane.components.center, np.eye(3), (camera,), motion.rows_from_tester, None)
    scene = Scene((camera,), ((0, 0), (0, 2), (0, 3)), workshop)
    found = {view.part: view for view in central_views(plane, np.eye(3), scene, motion, views)}
    assert set(found) == set(range(4))
    for part, view in found.items():
        place = plane.components.center[[part]]
        off = {
            row: camera.project(apply(motion.rows_from_tester[row], place))[0] - camera.center_px
            for _, row in scene.present
        }
        assert view.frame == (0, min(off, key=lambda row: float(np.hypot(*off[row]))))
        assert view.half_px == pytest.approx([15.0, 7.5])


def test_a_board_type_without_components_has_no_views_of_them(workshop: Any) -> None:
    kind = BoardType.model_validate({"name": "b", "y_axis": "down", "outline": [[0, 0], [9, 9]], "components": []})
    plane, camera = BoardPlane(kind, mirrored=False), workshop.camera((0.0, 0.0), size_px=(480, 320), px_per_mm=15.0)
    motion = nominal_motion(np.zeros(1), np.zeros(2), np.zeros(2))
    views = FootprintViews.of(np.array([[0.0, 0.0], [9.0, 9.0]]), np.eye(3), (camera,), motion.rows_from_tester, None)
    assert central_views(plane, np.eye(3), Scene((camera,), ((0, 0),), workshop), motion, views) == []


def test_a_patch_is_reduced_by_an_odd_factor() -> None:
    assert [reduction(np.array([half, 3.0]), 20) for half in (5.0, 20.0, 21.0, 60.0, 61.0)] == [1, 1, 3, 3, 5]


def test_a_reduced_patch_is_that_about_the_nearest_pixel() -> None:
    grey = np.add.outer(np.arange(40), 2 * np.arange(50)).astype(np.uint8)
    patch = reduced_patch(grey, np.array([20.4, 14.6]), np.array([3, 2]), 3)
    assert patch is not None
    assert patch.shape == (5, 7)
    assert patch[2, 3] == pytest.approx(grey[15, 20])
    assert patch[2, 4] - patch[2, 3] == pytest.approx(6.0)
    assert reduced_patch(grey, np.array([2.0, 20.0]), np.array([3, 2]), 1) is None
