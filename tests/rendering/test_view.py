"""Directions from which components are seen, and the uncertainty of their places, against the geometry of the model."""

from __future__ import annotations

import math
from dataclasses import replace
from itertools import product
from typing import Any

import numpy as np
import pytest

from vaoi_station.rendering import Framing, ViewCalculator, compute_views
from vaoi_station.rendering.view import sigma_px


@pytest.mark.parametrize(("y_axis", "side"), list(product(("up", "down"), ("top", "bottom"))))
@pytest.mark.parametrize("surface", [False, True])
def test_the_direction_is_that_of_the_line_of_sight(make: Any, y_axis: str, side: str, surface: bool) -> None:
    """The line of sight: the CAD points that one pixel shows at two heights lie on it."""
    s = make(y_axis=y_axis, side=side, surface=surface, unit="inch")
    for component in s.board_type.components[::3]:
        center = np.array(component.center)
        height = float(s.stitch.surface.height_mm(center)) if surface else 0.0
        for view in compute_views(component, s.board_type, s.stitch, s.cameras):
            camera, d = s.cameras[view.camera], s.stitch.row_motion[view.row]
            pixel = s.raw_px(view.camera, view.row, center, height)
            above = camera.ground(pixel, height + 10.0)
            cad = s.stitch.tester_from_cad.inverse()((above - d[:2, 2]) @ d[:2, :2])
            along_mm = (cad - center) * s.board_type.mm_per_unit
            assert view.angle_deg is not None
            assert view.angle_deg == pytest.approx(math.degrees(math.atan2(np.hypot(*along_mm), 10.0)), abs=0.05)
            if view.azimuth_deg is not None and view.angle_deg > 0.5:
                expected = math.degrees(math.atan2(along_mm[1], along_mm[0]))
                assert abs((view.azimuth_deg - expected + 180) % 360 - 180) < 0.5


@pytest.mark.parametrize(("y_axis", "side"), list(product(("up", "down"), ("top", "bottom"))))
def test_a_raised_point_moves_away_from_the_side_the_part_is_seen_from(make: Any, y_axis: str, side: str) -> None:
    s = make(y_axis=y_axis, side=side)
    for component in s.board_type.components:
        for view in compute_views(component, s.board_type, s.stitch, s.cameras):
            if view.picture_azimuth_deg is None or (view.angle_deg or 0) < 0.5:
                continue
            center = np.array(component.center)
            raised = view.image_from_crop.inverse()(s.raw_px(view.camera, view.row, center, 2.0))
            shift = raised - view.crop_from_cad(center)
            away = math.degrees(math.atan2(-shift[1], shift[0])) + 180
            assert abs((view.picture_azimuth_deg - away + 180) % 360 - 180) < 1.0


def test_the_shift_per_mm_of_height_is_that_of_the_camera(make: Any) -> None:
    s = make(surface=True)
    for component in s.board_type.components:
        center = np.array(component.center)
        height = float(s.stitch.surface.height_mm(center))
        for view in compute_views(component, s.board_type, s.stitch, s.cameras):
            low, high = (s.raw_px(view.camera, view.row, center, height + h) for h in (-0.01, 0.01))
            np.testing.assert_allclose(view.lift_px, (high - low) / 0.02, rtol=1e-3, atol=1e-6)


def test_a_picture_at_the_top_of_the_part_is_right_there(make: Any) -> None:
    s = make(surface=True)
    component = s.board_type.components[4]
    calculator = ViewCalculator(s.board_type, s.stitch, s.cameras)
    height = float(s.stitch.surface.height_mm(np.array(component.center)))
    views = calculator.compute(component, framing=Framing(plane="top"), height_mm=3.0)
    assert views
    for view in views:
        assert (view.plane, view.height_mm) == ("top", 3.0)
        corner = np.array([view.width - 1.0, 0.0])
        truth = s.raw_px(view.camera, view.row, view.cad_from_crop(corner), height + 3.0)
        assert view.image_from_crop(corner) == pytest.approx(truth, abs=1e-6)
    unknown = calculator.compute(component, framing=Framing(plane="top"))
    assert {(v.plane, v.height_mm) for v in unknown} == {("board", 0.0)}


def test_without_working_distance_the_direction_is_unknown(make: Any) -> None:
    s = make()
    blind = tuple(replace(c, working_distance_mm=None) for c in s.cameras)
    view = compute_views(s.board_type.components[0], s.board_type, s.stitch, blind)[0]
    assert (view.angle_deg, view.azimuth_deg, view.picture_azimuth_deg) == (None, None, None)


def test_the_uncertainty_of_a_height_adds_along_the_parallax(make: Any) -> None:
    s = make()
    view = compute_views(s.board_type.components[0], s.board_type, s.stitch, s.cameras)[0]
    flat = np.diag([0.0004, 0.0001])
    assert sigma_px(flat) == pytest.approx(0.02)
    assert view.covariance_px2(None) is None
    assert sigma_px(None) is None
    level = view.covariance_px2(flat)
    raised = view.covariance_px2(flat, height_sigma_mm=0.5)
    assert raised is not None
    assert level is not None
    np.testing.assert_allclose(level, flat)
    assert raised.trace() - flat.trace() == pytest.approx(0.25 * (view.lift_px**2).sum())
    assert view.frame_px_per_mm == pytest.approx(8.0, rel=0.01)


def test_the_outline_is_that_of_the_footprint(make: Any) -> None:
    parts = [{"ref": "U1", "center": [12, 14], "width": 6, "height": 3, "rotation": 30}]
    s = make(components=parts)
    for view in compute_views(s.board_type.components[0], s.board_type, s.stitch, s.cameras, min_coverage=0.1):
        truth = s.raw_px(view.camera, view.row, np.array(s.board_type.footprint(s.board_type.components[0])))
        for corner in view.outline_px:
            assert np.abs(truth - corner).max(1).min() < 1.0
