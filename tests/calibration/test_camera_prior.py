from __future__ import annotations

from dataclasses import replace

import numpy as np
import pytest

from vaoi_station.calibration.camera_prior import RADIAL_PX, CameraPrior, shape_of_view

PRIOR = CameraPrior((695.5, 519.5), 868.8, 40.0, 483.0)


def test_stretch_and_perspective_are_displacements_at_the_corner() -> None:
    center = np.array([[1, 0, 695.5], [0, 1, 519.5], [0, 0, 1.0]])
    stretched = center @ np.diag([40.04, 39.96, 1.0])
    np.testing.assert_allclose(shape_of_view(PRIOR, stretched), [868.8 * 0.001, 0, 0, 0], atol=1e-3)
    tilted = center @ np.array([[40.0, 0, 0], [0, 40.0, 0], [-1e-5 * 40, 0, 1]])
    assert shape_of_view(PRIOR, tilted)[2] == pytest.approx(868.8**2 * 1e-5, rel=0.02)


def test_the_prior_of_the_tilt_follows_from_the_working_distance() -> None:
    near = replace(PRIOR, working_distance_mm=None)
    assert near.distance_mm == pytest.approx(2 * 868.8 / 40)
    assert near.sigma_px(1)[2] > 5 * PRIOR.sigma_px(1)[2]
    assert PRIOR.sigma_px(1)[-1] == RADIAL_PX
    assert len(PRIOR.sigma_px(2)) == 6


def test_a_board_that_is_not_flat_changes_scale_perspective_and_distortion() -> None:
    covariance = replace(PRIOR, flatness_mm=0.05).flatness_covariance_px2()
    sigma = np.sqrt(np.diag(covariance))
    assert sigma[[3, 6, 7, 8]] == pytest.approx(868.8 * 0.05 / 483)
    assert not sigma[[0, 1, 2, 4, 5]].any()
    assert not PRIOR.flatness_covariance_px2().any()
