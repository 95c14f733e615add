from __future__ import annotations

from typing import Literal

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.simulation.imaging.pinholes import mount_cameras
from vaoi_station.simulation.scenario import ArraySection

ARRAY = ArraySection(distortion_px=2.0, tilt_deg=0.3)


@given(st.floats(-15, 15), st.floats(-12, 12), st.floats(-2, 10), st.integers(0, 2))
def test_projection_and_ground_are_inverse(x: float, y: float, z: float, camera: int) -> None:
    pinhole = mount_cameras(ARRAY)[camera]
    place = np.array([[x + pinhole.foot_mm[0], y + pinhole.foot_mm[1]]])
    assert np.allclose(pinhole.ground(pinhole.project(place, z), z), place, atol=1e-9)


def test_the_station_s_formulas_for_heights_agree_with_the_projection() -> None:
    for pinhole in mount_cameras(ARRAY):
        known = pinhole.calibrated(ARRAY.working_distance_mm)
        place = np.random.default_rng(1).uniform(-12, 12, (50, 2)) + pinhole.foot_mm
        for z in (0.0, 0.5, 6.0):
            # geometry.Camera finds the foot from N_i and the working distance
            assert np.abs(pinhole.project(place, z) - known.project(place, np.full(50, z))).max() < 1e-3


def test_distortion_at_the_corner_is_as_large_as_stated() -> None:
    for pinhole in mount_cameras(ARRAY):
        corner = np.array([[-0.5, -0.5]])
        shift = float(np.hypot(*(pinhole.lens.undistort(corner) - corner)[0]))
        assert 0.59 * ARRAY.distortion_px < shift < 1.41 * ARRAY.distortion_px


@given(st.sampled_from(["x", "y", "z"]), st.floats(-0.05, 0.05))
def test_a_rotation_keeps_the_position_of_a_camera(about: Literal["x", "y", "z"], angle_rad: float) -> None:
    """The point vertically below the lens at its own height has no finite image before or after."""
    pinhole = mount_cameras(ARRAY)[1]
    rotated = pinhole.rotated(about, angle_rad)
    center = np.linalg.svd(pinhole.projection)[2][-1]
    assert np.abs(rotated.projection @ center).max() < 1e-6 * np.abs(rotated.projection).max()
    back = rotated.rotated(about, -angle_rad)
    assert np.allclose(back.projection, pinhole.projection)
