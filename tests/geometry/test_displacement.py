"""Displacements as they act on cameras."""

from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.geometry import Camera, Lens, Projective, System
from vaoi_station.geometry.displacement import (
    CameraMatrices,
    rms_displacement_px,
)
from vaoi_station.geometry.transforms import apply

N = np.array([[40.0, 0.1, 300.0], [-0.1, 40.0, 200.0], [1e-6, -2e-6, 1.0]])
CAMERA = Camera(641, 481, Projective(N, System.IMAGE, System.ROW), Lens((0.0, 0.0), 1.0), 400.0)
px = st.floats(-40, 40)


def moved_from_calibrated(camera: Camera, displacement_px: np.ndarray) -> np.ndarray:
    return np.asarray(CameraMatrices.of([camera]).moved(displacement_px[None])[0])


@given(x=px, y=px)
@pytest.mark.parametrize("distance_mm", [400.0, None])
def test_the_middle_of_the_picture_moves_by_x_and_y(distance_mm: float | None, x: float, y: float) -> None:
    t = moved_from_calibrated(replace(CAMERA, working_distance_mm=distance_mm), np.array([x, y, 0.0]))
    assert apply(t, CAMERA.center_px) - CAMERA.center_px == pytest.approx((x, y), abs=1e-3)


def test_the_size_is_the_rms_over_the_frame() -> None:
    d = np.array([0.3, -0.2, 0.9])
    grid = np.stack(np.meshgrid(np.linspace(0, 640, 161), np.linspace(0, 480, 121)), -1).reshape(-1, 2)
    t = moved_from_calibrated(replace(CAMERA, working_distance_mm=None), d)
    assert rms_displacement_px(d) == pytest.approx(np.sqrt(((apply(t, grid) - grid) ** 2).sum(1).mean()), rel=0.01)
