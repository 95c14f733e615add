"""Attribution of motion to cameras, from differences between neighbours alone."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.cameras import attribute_motion, prior_weights, spread_of_unseen_motion

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


STILL_PX, UNMOVED_PX = 0.006, 0.001
PUSHED_PX, PUSHED_SHARE = 0.1, 0.07
BLIND_PX, PUSHED_BLIND_PX = 0.2, 0.35
DRAWN = 400_000


@pytest.mark.parametrize("others_px", [0.003, 2.0])
@pytest.mark.parametrize(("shown_px", "seen_at_px"), [(0.002, 0.0), (0.05, 0.0), (0.1, 0.3), (0.3, 0.1), (2.0, 0.0)])
def test_what_a_push_adds_is_that_of_the_whole_distribution(
    shown_px: float, seen_at_px: float, others_px: float
) -> None:
    """Compare with displacements drawn from the mixture and weighted by the likelihood of what the run shows."""
    information = np.diag(np.array([shown_px, others_px, others_px] * 2) ** -2.0)
    seen = np.array([seen_at_px, 0, 0, 0, 0, 0])
    g, push_px = np.random.default_rng(0), PUSHED_PX if others_px < BLIND_PX else PUSHED_BLIND_PX
    still = g.normal(0, UNMOVED_PX, DRAWN)
    drawn = still + np.where(g.random(DRAWN) < PUSHED_SHARE, g.normal(0, push_px, DRAWN), 0)
    square = [mean_square(d, shown_px, seen_at_px) for d in (still, drawn)]
    added = spread(information, seen, UNMOVED_PX)[0, 0] - unpushed(shown_px, UNMOVED_PX)
    assert added == pytest.approx(square[1] - square[0], rel=0.1, abs=(0.1 * STILL_PX) ** 2)


@pytest.mark.parametrize("unmoved_px", [UNMOVED_PX, 0.03])
@pytest.mark.parametrize("shown_px", [0.001, 0.003, 0.006])
def test_a_camera_that_was_not_pushed_has_the_error_of_the_estimate(shown_px: float, unmoved_px: float) -> None:
    """Compare with estimates of drawn displacements: narrower than the curvature of the prior, or as wide as stated."""
    g = np.random.default_rng(1)
    moved = g.normal(0, unmoved_px, DRAWN)
    weight = float(prior_weights(np.zeros((1, 3)), STILL_PX)[0])
    estimate = (moved + g.normal(0, shown_px, DRAWN)) / (1 + weight * shown_px**2)
    assert unpushed(shown_px, unmoved_px) + 1 / (shown_px**-2 + weight) == pytest.approx(
        np.mean((estimate - moved) ** 2), rel=0.02
    )
    information = np.eye(6) * shown_px**-2
    rare = 2 * PUSHED_SHARE * shown_px**3 / PUSHED_PX
    assert spread(information, np.zeros(6), unmoved_px)[0, 0] == pytest.approx(
        unpushed(shown_px, unmoved_px), abs=rare + 1e-9
    )


def test_links_that_show_a_camera_to_a_fifth_of_a_push_leave_little_of_it() -> None:
    """Most boards pass under cameras that have not moved, and their links say so: sigma must follow them."""
    seen = np.sqrt(0.02**-2 + prior_weights(np.zeros((1, 3)), STILL_PX)[0]) ** -1
    assert spread(np.eye(6) * 0.02**-2, np.zeros(6), UNMOVED_PX)[0, 0] + seen**2 < (STILL_PX / 2) ** 2
    assert spread(np.eye(6) * 0.3**-2, np.zeros(6), UNMOVED_PX)[0, 0] > (4 * STILL_PX) ** 2


def test_a_camera_beside_a_blank_overlap_may_have_been_pushed_further() -> None:
    """Hostile drawing 106038: nothing across the row of cameras shows where camera 0 is, and σ was 0.03 px.

    Along the row of cameras any push looks like a lift of the board, blank overlap or not: that decides nothing.
    """
    shown = np.diag(np.array([0.1, 0.02, 0.02] * 2) ** -2.0)
    blank = shown.copy()
    blank[1, 1] = 0.3**-2
    seen, blind = (np.diag(spread(i, np.zeros(6), UNMOVED_PX)) for i in (shown, blank))
    assert blind[1] > 0.04**2
    assert seen[1] < 1e-5
    assert blind[3:] == pytest.approx(seen[3:])


def spread(information: Floats, seen: Floats, unmoved_px: float) -> Floats:
    """Return the spread of two cameras that are estimated where they were calibrated, and seen at `seen` (6,)."""
    estimate = np.zeros((2, 3))
    weight = prior_weights(estimate, STILL_PX)
    return spread_of_unseen_motion(information, information @ seen, estimate, weight, np.full(2, unmoved_px))


def mean_square(drawn: Floats, shown_px: float, seen_at_px: float) -> float:
    likely = np.exp(-((drawn - seen_at_px) ** 2) / (2 * shown_px**2))
    return float(likely @ drawn**2 / likely.sum())


def unpushed(shown_px: float, unmoved_px: float) -> float:
    """Return by how much the error of a camera that was not pushed exceeds the curvature, px²."""
    weight = float(prior_weights(np.zeros((1, 3)), STILL_PX)[0])
    return (weight * unmoved_px**2 - 1) * weight / (shown_px**-2 + weight) ** 2
