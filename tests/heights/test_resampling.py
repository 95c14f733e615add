"""Resampling on a mesh against values that are known."""

from __future__ import annotations

import numpy as np
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.heights import resampling


def sample(image: np.ndarray, nodes: np.ndarray, step: int, out: np.ndarray) -> None:
    """Sample an image of which the whole is cut out."""
    place = np.array([0, 0, 0, *image.shape[::-1]])
    resampling.sample(image.astype(np.float32).ravel(), place, nodes, step, out)


def mesh(x0: float, y0: float, scale: float) -> np.ndarray:
    x, y = np.meshgrid(x0 + scale * 6 * np.arange(4), y0 + scale * 6 * np.arange(4))
    return np.stack([x, y], -1)


def test_whole_pixels_are_copied() -> None:
    image = np.random.default_rng(1).integers(0, 255, (40, 40), dtype=np.uint8)
    out = np.empty((18, 18), np.float32)
    sample(image, mesh(5, 7, 1.0), 6, out)
    np.testing.assert_allclose(out, image[7:25, 5:23], atol=1e-3)


def test_a_slope_is_interpolated_between_pixels() -> None:
    y, x = np.mgrid[:40, :40]
    image = (100 + 2 * x + y).astype(np.uint8)
    out = np.empty((18, 18), np.float32)
    sample(image, mesh(5.3, 7.6, 0.7), 6, out)
    rows, columns = np.mgrid[:18, :18]
    np.testing.assert_allclose(out, 100 + 2 * (5.3 + 0.7 * columns) + 7.6 + 0.7 * rows, atol=0.1)


def test_there_is_no_value_outside_the_image() -> None:
    out = np.empty((18, 18), np.float32)
    sample(np.full((40, 40), 9, np.uint8), mesh(-3, 30, 1.0), 6, out)
    assert np.isnan(out[:, :4]).all()
    assert np.isnan(out[9:]).all()
    np.testing.assert_allclose(out[:6, 6:], 9, atol=1e-4)


@given(st.floats(-12, 45), st.floats(-12, 45), st.floats(0.2, 3.0), st.booleans())
def test_values_are_those_of_the_kernel_wherever_the_mesh_lies(x0: float, y0: float, scale: float, lost: bool) -> None:
    """Also across the borders of the image, and beside nodes that have no position."""
    image = np.random.default_rng(2).integers(0, 255, (40, 40), dtype=np.uint8)
    nodes = mesh(x0, y0, scale)
    if lost:
        nodes[0, 0] = np.nan
    out = np.empty((18, 18), np.float32)
    sample(image, nodes, 6, out)
    for y, x in ((0, 0), (5, 11), (8, 8), (17, 0), (17, 17)):
        u, v = x0 + scale * x, y0 + scale * y
        near = min(u - 2, v - 2, 37 - u, 37 - v)
        if abs(near) < 1e-9:
            continue  # rounding decides
        if near < 0 or (lost and x < 6 and y < 6):
            assert np.isnan(out[y, x])
            continue
        weights = [np.sinc(t) * np.sinc(t / 3) for t in (np.arange(-2, 4) - (p - int(p)) for p in (u, v))]
        part = image[int(v) - 2 : int(v) + 4, int(u) - 2 : int(u) + 4]
        expected = weights[1] @ part @ weights[0] / (weights[0].sum() * weights[1].sum())
        assert abs(out[y, x] - expected) < 0.5
