"""Points of several sources are joined in order; displacements are compared by how well they fit."""

from __future__ import annotations

import numpy as np

from vaoi_station.stitching.adjustment.problem import REFERENCE, CameraEstimate, FiducialPoints


def points(count: int, which: int) -> FiducialPoints:
    g = np.random.default_rng(count)
    pairs = g.normal(0, 1, (3, count, 2))
    sigma, px = g.uniform(0, 1, (2, count))
    camera = np.arange(count) % 3
    return FiducialPoints(np.arange(count), pairs[0], pairs[1], pairs[2], sigma, px, np.full(count, which), camera)


def test_joined_points_keep_their_values_and_their_order() -> None:
    first, second = points(3, 1), points(2, REFERENCE)
    joined = FiducialPoints.joined([first, FiducialPoints.empty(), second])
    assert joined.which.tolist() == [1, 1, 1, REFERENCE, REFERENCE]
    assert joined.row.tolist() == [0, 1, 2, 0, 1]
    for name in ("ground_mm", "lean", "cad", "sigma_mm", "px_per_mm", "camera"):
        np.testing.assert_array_equal(getattr(joined, name)[3:], getattr(second, name))


def test_an_empty_set_has_the_types_of_others() -> None:
    empty, some = FiducialPoints.empty(), points(2, 0)
    for name, values in vars(empty).items():
        other = getattr(some, name)
        assert (len(values), values.dtype, values.shape[1:]) == (0, other.dtype, other.shape[1:])


def test_the_displacement_of_one_camera_alone_is_the_best_of_its_own() -> None:
    g = np.random.default_rng(2)
    half, true_px = g.normal(0, 1, (12, 9)), np.zeros((3, 3))
    true_px[1] = (0.3, -0.2, 0.1)
    information = half.T @ half
    estimate = CameraEstimate(
        np.zeros((3, 3)), np.eye(9), np.zeros((1, 9, 9)), information, information @ true_px.ravel()
    )
    np.testing.assert_allclose(estimate.alone(1), true_px, atol=1e-9)
    others = [estimate.alone(camera) for camera in (0, 2)]
    assert all(not np.delete(d, camera, axis=0).any() for camera, d in zip((0, 2), others, strict=True))
    assert estimate.fit(true_px) > max(*(estimate.fit(d) for d in others), estimate.fit(1.1 * true_px)) > 0
