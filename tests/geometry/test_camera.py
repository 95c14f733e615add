from __future__ import annotations

from collections.abc import Callable
from typing import Any

import numpy as np
from hypothesis import HealthCheck, given, settings
from hypothesis import strategies as st

from vaoi_station.geometry import Camera, Lens

Make = Callable[..., Camera]
shared = settings(suppress_health_check=[HealthCheck.function_scoped_fixture], max_examples=60)
tilts = st.tuples(st.floats(-0.05, 0.05), st.floats(-0.05, 0.05), st.floats(-3.1, 3.1))
places = st.tuples(st.floats(-300, 300), st.floats(-300, 300), st.floats(200, 900))
offsets = st.lists(st.tuples(st.floats(-20, 20), st.floats(-15, 15)), min_size=1, max_size=5).map(np.array)
LENS = Lens((695.5, 519.5), 868.8, (-0.0012, 0.0004))


@shared
@given(place=places, tilt=tilts, y_down=st.booleans(), focal=st.floats(0.9, 1.1))
def test_foot_is_below_a_tilted_camera(
    *, pinhole: Any, calibrated: Make, place: Any, tilt: Any, y_down: bool, focal: float
) -> None:
    camera = calibrated(pinhole(focal * 40 * place[2], place, tilt, y_down))
    np.testing.assert_allclose(camera.foot_mm, place[:2], atol=1e-3)


@shared
@given(place=places, tilt=tilts, y_down=st.booleans(), around=offsets, height=st.floats(-5, 60))
def test_projection_of_heights_agrees_with_a_pinhole_camera(
    *, pinhole: Any, calibrated: Make, place: Any, tilt: Any, y_down: bool, around: Any, height: float
) -> None:
    truth = pinhole(40 * place[2], place, tilt, y_down)
    p = around + np.array(place[:2])
    expected = truth.project(np.column_stack([p, np.full(len(p), height)]))
    np.testing.assert_allclose(calibrated(truth).project(p, height), expected, atol=1e-3)


@shared
@given(tilt=tilts, around=offsets, heights=st.lists(st.floats(-5, 60), min_size=5, max_size=5))
def test_ground_inverts_project_at_each_height(
    pinhole: Any, calibrated: Make, tilt: Any, around: Any, heights: list[float]
) -> None:
    camera = calibrated(pinhole(40 * 483.0, (100.0, -50.0, 483.0), tilt), lens=LENS)
    p, h = around + np.array((100, -50)), np.array(heights[: len(around)])
    np.testing.assert_allclose(camera.ground(camera.project(p, h), h), p, atol=1e-8)


@shared
@given(tilt=tilts, around=offsets, height=st.floats(-5, 60))
def test_the_homography_of_a_plane_at_a_height_agrees_with_project(
    pinhole: Any, calibrated: Make, tilt: Any, around: Any, height: float
) -> None:
    camera = calibrated(pinhole(40 * 483.0, (100.0, -50.0, 483.0), tilt), lens=LENS)
    p = around + np.array((100, -50))
    undistorted = camera.image_from_row_at(height)(p)
    np.testing.assert_allclose(camera.lens.distort(undistorted), camera.project(p, height), atol=1e-8)


@shared
@given(tilt=tilts, a1=st.floats(-0.02, 0.02))
def test_all_visible_points_lie_in_the_box_of_the_view(pinhole: Any, calibrated: Make, tilt: Any, a1: float) -> None:
    lens = Lens((695.5, 519.5), 868.8, (a1,))
    camera = calibrated(pinhole(40 * 483.0, (100.0, -50.0, 483.0), tilt), lens=lens)
    low, high = camera.view_mm()
    size = np.array([camera.width_px, camera.height_px]) - 1
    places = camera.ground(size * np.random.default_rng(1).uniform(0, 1, (200, 2)))
    assert ((places >= low) & (places <= high)).all()


def test_distant_points_do_not_fold_back_into_the_frame(pinhole: Any, calibrated: Make) -> None:
    camera = calibrated(pinhole(40 * 483.0, (0.0, 0.0, 483.0), (0.0, 0.0, 0.0)), lens=LENS)
    far = np.column_stack([np.linspace(20, 4000, 400), np.zeros(400)])
    assert not camera.sees(camera.project(far)).any()
