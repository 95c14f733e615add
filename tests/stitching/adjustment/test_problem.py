"""The basis of the surface, and its conversion to a result."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.geometry import Lens
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.problem import (
    SIGMA_MM,
    LinkStore,
    basis,
    prior_sigma_mm,
    to_observations,
    to_surface,
)
from vaoi_station.stitching.matching.evidence import Links, Task
from vaoi_station.stitching.matching.patches import match_patches, patch_centres
from vaoi_station.stitching.matching.refinement import WINDOW_PX


def links(task: Task, a: Any, b: Any, information: Any = None) -> Links:
    k = len(a)
    return Links(
        task,
        np.array(a),
        np.array(b),
        np.tile(np.eye(2), (k, 1, 1)) if information is None else information,
        np.ones(k),
    )


@pytest.mark.parametrize("bend", [0.0, 0.003])
def test_noise_is_propagated_to_the_ground(workshop: Any, bend: float) -> None:
    """Compare with the scatter of many noisy pixels, for a tilted, rotated camera."""
    lens = Lens((99.5, 79.5), 128.0, (bend,))
    camera = workshop.camera((3, 1), angle_rad=0.3, tilt=(2e-3, -1e-3), distance_mm=100.0, lens=lens)
    covariance = np.array([[0.04, 0.01], [0.01, 0.02]])
    px = np.array([150.0, 120.0])
    o = to_observations([links(Task("rows", (0, 0), (0, 1)), [px], [px], np.linalg.inv(covariance)[None])], (camera,))
    noisy = camera.ground(px + np.random.default_rng(0).multivariate_normal([0, 0], covariance, 20000))
    np.testing.assert_allclose(o.noise_mm2[0], np.cov(noisy.T), rtol=0.06, atol=1e-5)
    np.testing.assert_allclose(o.b_lean[0], camera.parallax(camera.ground(px)))


def test_links_projected_early_are_the_same_in_any_requested_order(workshop: Any) -> None:
    cameras = (workshop.camera((0, 0)), workshop.camera((15, 0), angle_rad=0.1))
    chance = np.random.default_rng(2)
    found = [
        links(
            Task("rows", (k % 2, k), (k % 2, k + 1)), chance.uniform(20, 150, (n, 2)), chance.uniform(20, 150, (n, 2))
        )
        for k, n in enumerate((3, 3000, 0, 1, 2500, 80))
    ]
    link_store = LinkStore(cameras)
    for k in (4, 1, 5):
        link_store.part((found[k],))
    link_store.lay(2)
    first = link_store.observations([(e,) for e in found])
    a_mm = first.a_mm.copy()
    for asked in (found, found[::-1], found[2:], []):
        once = to_observations(asked, cameras)
        again = link_store.observations([(e,) for e in asked])
        for name in once.arrays._fields:
            assert np.array_equal(getattr(once, name), getattr(again, name)), name
        assert again.groups == once.groups
        assert again.begins.tolist() == np.cumsum([0, *(len(e.a_px) for e in again.groups)]).tolist()
    other = links(found[0].task, [[50.0, 60.0]], [[70.0, 80.0]])
    both = link_store.observations([(found[0], other)])
    np.testing.assert_allclose(both.a_mm, cameras[0].ground(np.concatenate([found[0].a_px, other.a_px])))
    assert np.array_equal(first.a_mm, a_mm), "what is laid later does not change observations"


def test_only_patches_of_the_same_frames_overlap(workshop: Any) -> None:
    """Of four patches two cover half of each other; in the frames of the other camera they are other pixels."""
    px = np.array([[40.0, 40.0], [40.0 + WINDOW_PX / 2, 40.0], [120.0, 40.0], [40.0, 40.0 + WINDOW_PX]])
    found = [links(Task("rows", (i, 0), (i, 1)), px, px) for i in range(2)]
    cameras = (workshop.camera(), workshop.camera((15, 0)))
    assert to_observations(found, cameras).overlap == pytest.approx([1.5, 1.5, 1.0, 1.0] * 2)


def test_the_mean_of_patches_that_overlap_is_as_sure_as_their_overlap_says(workshop: Any) -> None:
    """Two pictures of one texture, with fresh noise in each of 60 repetitions; one patch begins every 8 px."""
    y, x = np.mgrid[30:90:8, 30:90:8]
    corners = np.stack([x.ravel(), y.ravel()], -1)
    at, chance, true = (
        patch_centres(corners),
        np.random.default_rng(4),
        workshop.waves(2).picture(120, 120).astype(float),
    )
    squares, stated = [], []
    for _ in range(60):
        a, b = (np.clip(np.round(true + chance.normal(0, 4, true.shape)), 0, 255).astype(np.uint8) for _ in range(2))
        found = match_patches(a, b, corners, at)
        seen = links(Task("rows", (0, 0), (0, 1)), at, found.b_px, found.information)
        overlap = to_observations([seen], (workshop.camera(),)).overlap
        weight = np.trace(found.information, axis1=1, axis2=2) / 2 / overlap
        squares.append((((found.b_px - at) * weight[:, None]).sum(0) / weight.sum()) ** 2)
        stated.append(1 / weight.sum())
    ratio = np.mean(squares) / np.mean(stated)
    print("variance of the mean over the stated one:", ratio, "and if links were independent:", ratio * overlap.mean())
    assert 0.6 < ratio < 1.4
    assert ratio * overlap.mean() > 4.0


BOARD = BoardType(name="b", unit="inch", outline=((0.0, 3.0), (2.0, 0.5)))


@given(
    st.lists(st.floats(-1, 1), min_size=6, max_size=6),
    st.lists(st.tuples(st.floats(-1, 4), st.floats(-1, 5)), min_size=1, max_size=5),
)
def test_results_have_the_estimated_surface(c: list[float], points: list[tuple[float, float]]) -> None:
    at = np.array(points)
    surface = to_surface(BOARD, np.array(c))
    np.testing.assert_allclose(surface.height_mm(at), basis(BOARD, at) @ c, atol=5e-5)


def test_the_prior_of_the_surface_has_heavy_tails() -> None:
    assert prior_sigma_mm(np.zeros(6), SIGMA_MM).tolist() == SIGMA_MM.tolist()
    likely = prior_sigma_mm(SIGMA_MM / 2, SIGMA_MM)
    assert (likely < 1.1 * SIGMA_MM).all()
    tilted = prior_sigma_mm(np.array([0.2, 0.4, -0.6, 0, 0, 0]), SIGMA_MM)
    # A tilt along one axis widens the prior along the other one, and leaves lift and bow.
    assert (tilted[1:3] > 3 * SIGMA_MM[1:3]).all()
    assert tilted[[0, 3, 4, 5]].tolist() == pytest.approx(SIGMA_MM[[0, 3, 4, 5]], rel=0.01)
