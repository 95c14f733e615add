"""The sweep over heights against a few lines of numpy, and its limits."""

from __future__ import annotations

import numpy as np

from vaoi_station.heights.sweep import sweep

MARGIN, TILES = 12, np.array([(4, 4, 10, 10), (20, 10, 10, 10)])
FEET = np.array([[20.0, -150.0], [20.0, 190.0], [20.0, 20.0]])
SHARES = np.linspace(0.0, 0.02, 11)[:, None] * np.ones(3)


def pictures(true_share: float) -> np.ndarray:
    """Three pictures of one plane at a height, on the plane of the board."""
    y, x = np.mgrid[: 40 + 2 * MARGIN, : 50 + 2 * MARGIN] - float(MARGIN)
    out = []
    for foot, gain in zip(FEET, (1.0, 0.6, 1.3), strict=True):
        u, v = x * (1 - true_share) + true_share * foot[0], y * (1 - true_share) + true_share * foot[1]
        out.append(90 + gain * 20 * (np.sin(0.6 * u + 0.2 * v) + np.sin(0.5 * v - 0.3 * u)))
    return np.array(out, np.float32)


def test_the_true_height_leaves_nothing_unexplained() -> None:
    sums, _, freedom, used = sweep(pictures(0.01), MARGIN, FEET, SHARES, TILES, np.zeros(3, np.int64), 250.0)
    assert used.all()
    assert freedom.tolist() == [2 * 97, 2 * 97]
    assert (sums.argmin(1) == 5).all()
    assert (sums[:, 5] < 0.05 * sums[:, 0]).all()


def test_the_remainder_is_the_trace_minus_the_largest_eigenvalue() -> None:
    stack = pictures(0.01) + np.random.default_rng(1).normal(0, 3, (3, 64, 74)).astype(np.float32)
    sums, texture, _, _ = sweep(stack, MARGIN, FEET, SHARES[:1], TILES[:1], np.zeros(3, np.int64), 250.0)
    part = stack[:, MARGIN + 4 : MARGIN + 14, MARGIN + 4 : MARGIN + 14].astype(np.float64)
    y, x = np.mgrid[:10, :10] - 4.5
    plane = np.column_stack([np.ones(100), x.ravel(), y.ravel()])
    flat = part.reshape(3, -1).T
    flat = flat - plane @ np.linalg.lstsq(plane, flat, rcond=None)[0]
    values = np.linalg.eigvalsh(flat.T @ flat)
    np.testing.assert_allclose(sums[0, 0], values[:-1].sum(), rtol=0.02)
    variance = (flat**2).sum(0) / 97
    expected = 97 * (np.log(variance).sum() - np.log(values[-1] / 97))
    np.testing.assert_allclose(texture[0, 0], expected, rtol=0.01)


def test_groups_saturation_and_borders_limit_what_is_compared() -> None:
    stack = pictures(0.01)
    _, _, freedom, used = sweep(stack, MARGIN, FEET, SHARES, TILES, np.array([0, 0, 1]), 250.0)
    assert used.tolist() == [[True, True, False]] * 2
    assert freedom.tolist() == [97, 97]
    stack[0, MARGIN + 4 : MARGIN + 14, MARGIN + 4 : MARGIN + 14] = 255
    stack[1, :, MARGIN + 20 :] = np.nan
    _, _, freedom, used = sweep(stack, MARGIN, FEET, SHARES, TILES, np.zeros(3, np.int64), 250.0)
    assert used.tolist() == [[False, True, True], [True, False, True]]
