"""Attribution of motion to cameras, from differences between neighbours alone."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.camera_prior import attribute_motion

SIGMA_PX = 0.02


def between_neighbours(d: Floats) -> tuple[Floats, Floats]:
    """Information and vector of differences of neighbours, for displacements (n, 3)."""
    size = d.size
    a = np.zeros((size - 3, size))
    for k in range(size - 3):
        a[k, k], a[k, k + 3] = -1, 1
    a /= SIGMA_PX
    return a.T @ a, a.T @ a @ d.ravel()


@pytest.mark.parametrize("camera", [0, 1, 2, 3])
@pytest.mark.parametrize("moved", [(34.0, 0.0, 0.0), (0.0, 0.4, -0.8)])
def test_one_camera_of_four_that_moved_is_named(camera: int, moved: tuple[float, float, float]) -> None:
    d = np.zeros((4, 3))
    d[camera] = moved
    found = attribute_motion(*between_neighbours(d))
    assert found.moved == (camera,)
    assert found.rivals == ()
    assert found.displacement_px == pytest.approx(d, abs=0.02)


def test_two_cameras_of_five() -> None:
    d = np.zeros((5, 3))
    d[1], d[4] = (3.0, -1.0, 0.5), (0.0, 2.0, 0.0)
    found = attribute_motion(*between_neighbours(d))
    assert found.moved == (1, 4)
    assert found.displacement_px == pytest.approx(d, abs=0.02)


def test_with_two_cameras_the_first_is_corrected_and_the_other_named() -> None:
    d = np.array([[0.0, 0.0, 0.0], [5.0, -1.0, 0.3]])
    found = attribute_motion(*between_neighbours(d))
    assert (found.moved, found.rivals) == ((0,), (1,))
    assert found.displacement_px[0] == pytest.approx(-d[1], abs=0.02)


def test_a_motion_of_the_whole_array_is_not_attributed() -> None:
    found = attribute_motion(*between_neighbours(np.full((4, 3), 7.0)))
    assert found.moved == ()
    assert found.displacement_px == pytest.approx(np.zeros((4, 3)), abs=1e-6)
