"""Attribution of motion to cameras, from differences between neighbours alone."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.camera_prior import attribute_motion, prior_weights, spread_of_unseen_motion

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


STILL_PX = 0.006


@pytest.mark.parametrize("others_px", [0.003, 2.0])
@pytest.mark.parametrize(("shown_px", "seen_at_px"), [(0.002, 0.0), (0.05, 0.0), (0.1, 0.3), (0.3, 0.1), (2.0, 0.0)])
def test_the_spread_of_an_unseen_motion_is_that_of_the_whole_distribution(
    shown_px: float, seen_at_px: float, others_px: float
) -> None:
    """Compare with displacements drawn from the prior and weighted by the likelihood of what the run shows."""
    information = np.diag(np.array([shown_px, others_px, others_px] * 2) ** -2.0)
    seen = np.array([seen_at_px, 0, 0, 0, 0, 0])
    still, estimate = np.full(2, STILL_PX), np.zeros((2, 3))
    spread = spread_of_unseen_motion(
        information, information @ seen, estimate, prior_weights(estimate, STILL_PX), still
    )
    g = np.random.default_rng(0)
    drawn = STILL_PX / 2 * g.standard_cauchy(400_000)
    # The mixture ends at 128 times its scale, which a prior without variance needs.
    drawn = drawn[np.abs(drawn) < 150 * STILL_PX]
    likely = np.exp(-((drawn - seen_at_px) ** 2) / (2 * shown_px**2))
    whole = likely @ drawn**2 / likely.sum()
    alone = 1 / (1 / shown_px**2 + prior_weights(estimate, STILL_PX)[0])
    assert spread[0, 0] == pytest.approx(max(whole - alone, 0), rel=0.5, abs=(0.1 * STILL_PX) ** 2)


def test_a_camera_that_many_links_show_has_no_unseen_motion() -> None:
    information, vector = between_neighbours(np.zeros((3, 3)))
    estimate = np.zeros((3, 3))
    spread = spread_of_unseen_motion(
        information * 400, vector, estimate, prior_weights(estimate, STILL_PX), np.full(3, STILL_PX)
    )
    assert np.sqrt(np.diag(spread).max()) < STILL_PX / 2
