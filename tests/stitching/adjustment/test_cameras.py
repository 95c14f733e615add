"""Displacements of cameras: their effect on ground points, and their estimate from links and fiducials."""

from __future__ import annotations

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.geometry import Camera, Lens, Projective, System
from vaoi_station.geometry.displacement import displaced_cameras
from vaoi_station.geometry.similarity import apply_similarity
from vaoi_station.geometry.transforms import Floats
from vaoi_station.stitching.adjustment.cameras import (
    attribute_motion,
    prior_weights,
    spread_of_unseen_motion,
)
from vaoi_station.stitching.adjustment.motion import Motion
from vaoi_station.stitching.adjustment.problem import (
    SIGMA_MM,
    AdjustmentResult,
    FiducialPoints,
    Observations,
    Problem,
    SurfaceBasis,
    to_observations,
)
from vaoi_station.stitching.adjustment.solver import adjust
from vaoi_station.stitching.matching.evidence import Links, Task

SIGMA_PX = 0.02


def between_neighbours(d: Floats) -> tuple[Floats, Floats]:
    """Information and vector of differences of neighbours, for displacements (n, 3)."""
    size = d.size
    a = np.zeros((size - 3, size))
    for k in range(size - 3):
        a[k, k], a[k, k + 3] = -1, 1
    a /= SIGMA_PX
    return a.T @ a, a.T @ a @ d.ravel()


@pytest.mark.parametrize("camera", [0, 2])
@pytest.mark.parametrize("moved", [(34.0, 0.0, 0.0), (0.0, 0.4, -0.8)])
def test_one_camera_of_four_that_moved_is_named(camera: int, moved: tuple[float, float, float]) -> None:
    d = np.zeros((4, 3))
    d[camera] = moved
    found = attribute_motion(*between_neighbours(d))
    assert found.moved == (camera,)
    assert found.rivals == ()
    assert found.displacement_px == pytest.approx(d, abs=0.02)


STILL_PX, UNMOVED_PX = 0.006, 0.001
PUSHED_PX, PUSHED_SHARE = 0.1, 0.07
BLIND_PX, PUSHED_BLIND_PX = 0.2, 0.35
DRAWN = 400_000


@pytest.mark.parametrize("others_px", [0.003, 2.0])
@pytest.mark.parametrize(("shown_px", "seen_at_px"), [(0.002, 0.0), (0.1, 0.3), (2.0, 0.0)])
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
@pytest.mark.parametrize("shown_px", [0.001, 0.006])
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


Array = NDArray[np.float64]
SIZE, PX_PER_MM, ROWS = (480, 360), 14.0, 4
TIMES = np.arange(ROWS, dtype=np.float64) * 0.1
MOTION = Motion(np.array([0.0, 1e-3, -5e-4, 2e-4]), np.array([[0.02 * j, -6.1 * j] for j in range(ROWS)]), np.zeros(2))
C = np.array([1.0, 0.0, -12.0, -10.0])
FIDUCIALS = np.array([(5.0, 5.0), (75.0, 25.0), (40.0, -12.0)])


def camera(x_mm: float) -> Camera:
    n = np.array([[PX_PER_MM, 0, 239.5 - PX_PER_MM * x_mm], [0, PX_PER_MM, 179.5], [0, 0, 1.0]])
    return Camera(*SIZE, Projective(n, System.IMAGE, System.ROW), Lens((0.0, 0.0), 1.0), 300.0)


CAMERAS = tuple(camera(28.0 * i) for i in range(3))


def links_of(cameras: tuple[Camera, ...], noise_px: float) -> Observations:
    """Links of a textured board under displaced cameras, projected by the calibration."""
    g = np.random.default_rng(0)
    board, out = g.uniform((-14, -30), (70, 14), (900, 2)), []
    rows = [((i, j), (i, j + 1)) for i in range(3) for j in range(ROWS - 1)]
    for a, b in rows + [((i, j), (i + 1, j)) for i in (0, 1) for j in range(ROWS)]:
        px = [cameras[i].project(MOTION.row_from_tester(j)(board)) for i, j in (a, b)]
        use = np.flatnonzero(cameras[a[0]].sees(px[0], 8) & cameras[b[0]].sees(px[1], 8))[:40]
        task = Task("rows" if a[0] == b[0] else "neighbours", a, b)
        seen = px[1][use] + g.normal(0, noise_px, (len(use), 2))
        out.append(Links(task, px[0][use], seen, np.tile(np.eye(2) / 0.02**2, (len(use), 1, 1)), np.ones(len(use))))
    return to_observations(out, CAMERAS)


def adjusted(displacement_px: Array, noise_px: float = 0.0, fiducials: int = 3) -> AdjustmentResult:
    """Adjust a run whose cameras have moved since their calibration."""
    cameras = displaced_cameras(CAMERAS, displacement_px)
    links, found = links_of(cameras, noise_px), []
    for i, j in np.ndindex(3, ROWS):
        px = cameras[i].project(MOTION.row_from_tester(j)(apply_similarity(C, FIDUCIALS[:fiducials])))
        found += [(j, CAMERAS[i].ground(px[n]), n, i) for n in np.flatnonzero(cameras[i].sees(px, 8))]
    row, ground, which, seen_by = (np.array([f[k] for f in found]) for k in range(4))
    k, basis = len(found), np.zeros((len(found), 6))
    basis[:, 0] = 1
    points = FiducialPoints(
        row,
        ground,
        np.array([CAMERAS[i].parallax(g) for i, g in zip(seen_by, ground, strict=True)]),
        FIDUCIALS[which],
        np.full(k, 0.01 / PX_PER_MM),
        np.full(k, PX_PER_MM),
        which,
        seen_by,
    )
    at_links = np.zeros((len(links), 6))
    at_links[:, 0] = 1
    bare = np.full(len(links), -1)
    surface = SurfaceBasis(at_links, basis, SIGMA_MM)
    problem = Problem(TIMES, np.array([0.0, 61.0]), links, bare, points, surface=surface, cameras=CAMERAS)
    return adjust(problem, MOTION, C)


def moved(camera_number: int, *by: float) -> Array:
    d = np.zeros((3, 3))
    d[camera_number] = by
    return d


@pytest.mark.parametrize(
    ("number", "by"), [(1, (0.3, 0.0, 0.0)), (1, (0.0, -3.0, 0.5)), (2, (1.0, 0.0, 0.0)), (0, (0.1, 0.1, -0.4))]
)
def test_the_camera_that_moved_is_found_and_corrected(number: int, by: tuple[float, float, float]) -> None:
    found = adjusted(moved(number, *by), noise_px=0.02)
    assert found.cameras is not None
    estimate = found.cameras
    named = {i for i in range(3) if np.hypot.reduce(estimate.displacement_px[i]) > 0.06} | {*estimate.rivals}
    assert number in named
    o = found.problem.links
    assert np.abs(np.median(found.link_px[o.p == o.q], axis=0)).max() < 0.01
    assert (found.weight[o.p == o.q] > 0.2).mean() > 0.95, "links to a moved camera are no outliers"
    # in every camera, the corrected cameras see points of the board where they are
    board = np.array([(5.0, 5.0), (20.0, 0.0), (30.0, -5.0), (45.0, 3.0), (60.0, 8.0)])
    true = displaced_cameras(CAMERAS, moved(number, *by))
    for i, j in np.ndindex(3, ROWS):
        assert found.similarity is not None
        seen = true[i].project(MOTION.row_from_tester(j)(apply_similarity(C, board)))
        lift = found.surface_mm[0]
        place = found.motion.row_from_tester(j)(apply_similarity(found.similarity, board))
        off = found.problem.cameras[i].project(place, np.full(5, lift)) - seen
        here = true[i].sees(seen)
        assert np.abs(off[here]).max(initial=0.0) < 0.05


@pytest.mark.parametrize("number", [0, 1, 2])
def test_where_two_explanations_fit_the_uncertainty_covers_both(number: int) -> None:
    """With two fiducials a moved camera looks like another one that moved by half, on a board that lies lower."""
    found = adjusted(moved(number, 1.0, 0.0, 0.0), noise_px=0.02, fiducials=2).cameras
    assert found is not None
    sigma = np.sqrt(np.diag(found.covariance)).reshape(3, 3)
    assert (np.abs(found.displacement_px - moved(number, 1.0, 0.0, 0.0)) < 4 * sigma + 0.02).all()


def test_one_far_displaced_camera_is_not_taken_for_a_rotated_array() -> None:
    displacement = moved(1, 0.0, 34.0, 0.0)
    found = adjusted(displacement).cameras
    assert found is not None
    np.testing.assert_allclose(found.displacement_px, displacement, atol=0.1)
