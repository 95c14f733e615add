"""Every compiled loop against a few lines of numpy that say the same."""

from __future__ import annotations

import math
from collections.abc import Callable
from typing import Any, get_args

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vaoi_station.marks.candidate_kernels import RING, ring_offsets, scan_candidates, suppress_non_maxima
from vaoi_station.marks.disc_fit import FITTED, NO_EDGE, TOO_FAR, fit_disc
from vaoi_station.marks.mark_shape import Shape, coverage
from vaoi_station.marks.small_cholesky import position_variance, solve_cholesky
from vaoi_station.marks.symmetry_fit import fit_symmetry
from vaoi_station.marks.template_correlation import SHAPE_CODE, correlate_with_shape

SHAPES = get_args(Shape)
Paint = Callable[..., Any]
COMPILES = settings(deadline=None)
"""The first call waits for the compiler."""


@COMPILES
@given(st.integers(0, 2**31), st.integers(1, 4))
def test_normal_equations_are_solved_as_numpy_solves_them(seed: int, unknowns: int) -> None:
    g = np.random.default_rng(seed)
    design, right = g.normal(size=(12, unknowns)), g.normal(size=12)
    square = design.T @ design
    table = np.zeros((4, 5))
    table[:unknowns, :unknowns], table[:unknowns, 4] = np.triu(square), design.T @ right
    assert solve_cholesky(table, unknowns)
    assert np.allclose(table[:unknowns, 4], np.linalg.solve(square, design.T @ right), rtol=1e-6, atol=1e-9)
    if unknowns == 4:
        assert position_variance(table) == pytest.approx(np.diag(np.linalg.inv(square))[:2].mean(), rel=1e-6)


def test_equations_that_fix_nothing_are_told() -> None:
    table = np.zeros((4, 5))
    table[:2, :2] = 1.0
    assert not solve_cholesky(table, 2)
    assert not solve_cholesky(np.zeros((4, 5)), 1)


def test_every_pixel_with_a_bare_rim_and_no_other_is_correlated(paint: Paint) -> None:
    image = paint([("circle", 30.2, 25.7, 7.0), ("square", 60.1, 30.4, 7.0)], noise=2.0)
    template = coverage("circle", 7.0, 11)
    template -= template.mean()
    template /= np.sqrt((template**2).sum())
    ring = ring_offsets(5.0)
    found = scan_candidates(image, template, ring, 1, 0.5)
    expected = []
    for y in range(5, image.shape[0] - 5):
        for x in range(5, image.shape[1] - 5):
            core = [int(image[y + v, x + u]) for u, v in ((0, 0), (1, 0), (-1, 0), (0, 1), (0, -1))]
            axes = sorted(int(image[y + v, x + u]) for u, v in ((5, 0), (-5, 0), (0, 5), (0, -5)))
            rim = np.array([int(image[y + v, x + u]) for u, v in ring])
            lighter = axes[2] <= min(core) - 8 and (rim <= min(core) - 8).sum() >= RING - 4
            darker = axes[1] >= max(core) + 8 and (rim >= max(core) + 8).sum() >= RING - 4
            window = image[y - 5 : y + 6, x - 5 : x + 6].astype(float)
            window -= window.mean()
            score = abs((window * template).sum()) / max(np.sqrt((window**2).sum()), 1e-9)
            if (lighter or darker) and score >= 0.5:
                expected.append((x, y, score))
    assert len(expected) > 3
    assert np.allclose(found, expected, atol=1e-4)


def test_of_hits_side_by_side_the_best_is_kept() -> None:
    hits = np.array([[10.0, 10, 0.9], [12, 11, 0.8], [20, 10, 0.7], [10, 14, 0.6]])
    assert suppress_non_maxima(hits, 3, 9).tolist() == [0, 2, 3]
    assert suppress_non_maxima(hits, 3, 2).tolist() == [0, 2]


@pytest.mark.parametrize("shape", SHAPES)
def test_likeness_is_the_weighted_correlation_with_the_artwork(paint: Paint, shape: Shape) -> None:
    image, at = paint([(shape, 48.3, 40.6, 18.0)], noise=4.0), (48.3, 40.6)
    score, contrast = correlate_with_shape(image, *at, SHAPE_CODE[shape], 18.0, 0.25, 36.0)
    y, x = np.mgrid[: image.shape[0], : image.shape[1]]
    u, v = np.abs(x - at[0]), np.abs(y - at[1])
    outside = {
        "circle": np.hypot(u, v) - 9,
        "square": np.maximum(u, v) - 9,
        "diamond": (u + v - 9) / np.sqrt(2),
        "cross": np.minimum(np.maximum(u - 9, v - 2.25), np.maximum(u - 2.25, v - 9)),
    }[shape]
    t = np.clip(0.5 - outside / 2.85, 0, 1)
    q, w = t * t * (3 - 2 * t), np.clip(18.5 - np.hypot(u, v), 0, 1)
    p = image - np.average(image, weights=w)
    q = q - np.average(q, weights=w)
    assert contrast == pytest.approx((w * p * q).sum() / (w * q * q).sum(), rel=1e-9)
    assert score == pytest.approx((w * p * q).sum() / np.sqrt((w * p * p).sum() * (w * q * q).sum()), rel=1e-9)
    assert correlate_with_shape(np.full((80, 96), 7, np.uint8), *at, SHAPE_CODE[shape], 18.0, 0.25, 36.0) == (0.0, 0.0)


@COMPILES
@given(
    at=st.tuples(st.floats(-0.5, 0.5), st.floats(-0.5, 0.5)),
    radius=st.floats(4, 15),
    blur=st.floats(0.6, 1.2),
    slope=st.tuples(st.floats(-0.004, 0.004), st.floats(-0.004, 0.004)),
)
def test_a_disc_is_fitted_whatever_its_light_and_size(
    at: tuple[float, float], radius: float, blur: float, slope: tuple[float, float]
) -> None:
    y, x = np.mgrid[:80, :80]
    u, v = x - 40 - at[0], y - 40 - at[1]
    z = (np.hypot(u, v) - radius) / blur
    cover = 0.5 * np.vectorize(math.erfc)(z / math.sqrt(2))
    image = np.rint((60 + 120 * cover) * (1 + slope[0] * u + slope[1] * v)).clip(0, 255).astype(np.uint8)
    code, px, py, sigma, found_radius, found_blur, ground, contrast = fit_disc(
        image, 40 + 0.3 * radius, 40 - 0.3 * radius, 1.1 * radius, radius, 1, 1e-3, 12
    )
    assert code == FITTED
    assert np.hypot(px - 40 - at[0], py - 40 - at[1]) < 0.02
    assert 0 < sigma < 0.02
    assert found_radius == pytest.approx(radius, abs=0.1)
    assert found_blur == pytest.approx(blur, rel=0.1)
    assert ground == pytest.approx(60, abs=2)
    assert contrast == pytest.approx(120, abs=4)


def test_where_there_is_no_disc_none_is_fitted(paint: Paint) -> None:
    assert fit_disc(np.full((80, 96), 90, np.uint8), 48.0, 40.0, 8.0, 6.0, 1, 1e-3, 12)[0] == NO_EDGE
    far = fit_disc(paint([("circle", 60, 40, 16.0)]), 48.0, 40.0, 8.0, 6.0, 1, 1e-3, 12)
    assert far[0] == TOO_FAR


def test_a_symmetric_picture_is_centred_and_its_gain_may_slope() -> None:
    y, x = np.mgrid[:120, :120]
    u, v = x - 60.3, y - 58.8
    picture = (50 + 90 * np.exp(-(u**2 + 0.4 * u * v + 2 * v**2) / 150)) * (1 + 0.003 * u - 0.002 * v)
    code, px, py, sigma = fit_symmetry(picture.astype(np.float32), 62.0, 58.0, 20, 8.0, 2)
    assert code == 0
    assert np.hypot(px - 60.3, py - 58.8) < 2e-3
    assert 0 <= sigma < 0.01
