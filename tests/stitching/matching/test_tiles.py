"""Tiles agree with OpenCV's padding and filters."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st
from numpy.typing import NDArray

from vaoi_station.compiled import compiled
from vaoi_station.stitching.matching.refinement import (
    BINOMIAL,
    BLUR_REACH,
    PITCH_PX,
    WINDOW_PX,
    Pixels,
    Plane,
    blur,
    cut,
    saturated_share,
)

SIZE = WINDOW_PX + 2
SIDE = SIZE + 2 * BLUR_REACH


@compiled
def make_tile(image: Pixels, x0: int, y0: int, less: float) -> tuple[Pixels, Plane]:
    """Raw pixels and tile as `refine` makes them; helpers of compiled functions have no entry of their own."""
    raw, out = np.zeros(40 * PITCH_PX, np.uint8), np.zeros(34 * PITCH_PX, np.float32)
    cut(image, x0, y0, raw, SIZE, PITCH_PX, PITCH_PX)
    blur(raw, np.zeros(40 * PITCH_PX, np.float32), out, SIZE, PITCH_PX, less)
    return raw, out


@compiled
def share(raw: Pixels, x0: int, y0: int) -> float:
    return saturated_share(raw, SIZE, PITCH_PX, x0, y0)


def picture(seed: int) -> NDArray[np.uint8]:
    return np.random.default_rng(seed).integers(0, 256, (70, 80), dtype=np.uint8)


def lines(flat: NDArray[np.float32] | Pixels) -> NDArray[np.float64]:
    return flat[: len(flat) // PITCH_PX * PITCH_PX].reshape(-1, PITCH_PX).astype(np.float64)


@given(x0=st.integers(-40, 90), y0=st.integers(-40, 90), seed=st.integers(0, 5))
def test_a_tile_is_the_blurred_image_with_repeated_borders(x0: int, y0: int, seed: int) -> None:
    image = picture(seed)
    raw, tile = make_tile(image, x0, y0, 7.0)
    far = 60
    padded = cv2.copyMakeBorder(image, far, far, far, far, cv2.BORDER_REPLICATE)
    expected = padded[y0 + far : y0 + far + SIDE, x0 + far : x0 + far + SIDE].astype(np.float64)
    assert (lines(raw)[:SIDE, :SIDE] == expected).all()
    weights = np.array([*BINOMIAL[:0:-1], *BINOMIAL]) / 64
    soft = cv2.sepFilter2D(expected, -1, weights, weights)[BLUR_REACH:-BLUR_REACH, BLUR_REACH:-BLUR_REACH] - 7.0
    assert lines(tile)[:SIZE, :SIZE] == pytest.approx(soft, abs=1e-4)


@given(count=st.integers(0, 30), seed=st.integers(0, 100))
def test_the_saturated_share_counts_pixels_of_the_window(count: int, seed: int) -> None:
    g = np.random.default_rng(seed)
    raw = np.full((SIDE, PITCH_PX), 200, np.uint8)
    x, y = g.integers(0, SIDE, (2, count))
    raw[y, x] = g.integers(253, 256, count)
    x0, y0 = g.integers(0, SIDE - WINDOW_PX, 2).tolist()
    window = raw[y0 : y0 + WINDOW_PX, x0 : x0 + WINDOW_PX]
    assert share(raw.ravel(), x0, y0) == pytest.approx((window >= 254).mean())
