"""Sharpness and saturation, on frames whose blur, noise and saturated pixels are known."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest

from vaoi_station.rendering import View, compute_views
from vaoi_station.rendering.measures import Measures, measure


@pytest.fixture(scope="module")
def view(make: Any) -> View:
    s = make()
    return compute_views(s.board_type.components[4], s.board_type, s.stitch, s.cameras, min_coverage=1.0)[0]


def scene(blur_px: float = 0.0, shape: tuple[int, ...] = (180, 240)) -> Any:
    random = np.random.default_rng(2)
    blocks = cv2.resize(random.uniform(40, 200, (60, 80)), shape[1::-1], interpolation=cv2.INTER_NEAREST)
    return cv2.GaussianBlur(blocks, (0, 0), blur_px) if blur_px else blocks


def with_noise(values: Any, sigma: float) -> Any:
    noise = np.random.default_rng(7).normal(0, sigma, values.shape) if sigma else 0.0
    return np.clip(np.rint(values + noise), 0, 255).astype(np.uint8)


@pytest.mark.parametrize("noise", [0.0, 3.0])
def test_sharpness_falls_with_every_blur(view: View, noise: float) -> None:
    found = [
        measure(view, with_noise(scene(blur), noise)).sharpness_per_mm or 0.0 for blur in (0.5, 0.8, 1.2, 1.8, 2.5)
    ]
    assert found == sorted(found, reverse=True)
    assert found[0] > 1.5 * found[-1] > 0


def test_sharpness_does_not_depend_on_exposure_noise_or_depth(view: View) -> None:
    bright = measure(view, with_noise(scene(1.0), 0.0)).sharpness_per_mm
    assert bright is not None
    assert measure(view, with_noise(scene(1.0) / 3, 0.0)).sharpness_per_mm == pytest.approx(bright, rel=0.02)
    assert measure(view, with_noise(scene(1.0) / 3, 2.0)).sharpness_per_mm == pytest.approx(bright, rel=0.1)
    deep = measure(view, with_noise(scene(1.0), 0.0).astype(np.uint16) * 257)
    assert deep.sharpness_per_mm == pytest.approx(bright, rel=1e-3)
    colour = measure(view, cv2.merge([with_noise(scene(1.0), 0.0)] * 3))
    assert colour.sharpness_per_mm == pytest.approx(bright, rel=0.02)


def test_sharpness_of_a_wave_is_its_spatial_frequency(view: View) -> None:
    """A wave of 20 px has 2π/20 radians per px, 8 px per mm; Sobel answers sin(ω)/ω as strongly as a derivative."""
    x = np.mgrid[:180, :240][1]
    omega = 2 * np.pi / 20
    wave = np.rint(128 + 90 * np.cos(omega * x)).astype(np.uint8)
    expected = np.sin(omega) * view.frame_px_per_mm
    assert measure(view, wave).sharpness_per_mm == pytest.approx(expected, rel=0.1)


@pytest.mark.parametrize("dtype", [np.uint8, np.uint16])
def test_saturated_pixels_of_the_footprint_are_counted(view: View, dtype: Any) -> None:
    frame = scene(1.0).astype(dtype)
    left, top = np.ceil(view.outline_px.min(0)).astype(int) + 2
    frame[top : top + 6, left : left + 5] = np.iinfo(dtype).max
    frame[:10, :10] = np.iinfo(dtype).max  # outside the footprint
    area = 40 * 24 * (view.frame_px_per_mm / 8.0) ** 2
    assert measure(view, frame).saturated == pytest.approx(30 / area, rel=0.08)


def test_a_flat_footprint_has_no_sharpness(view: View) -> None:
    assert measure(view, np.full((180, 240), 90, np.uint8)) == Measures(None, 0.0)
    assert measure(view, np.full((180, 240), 255, np.uint8)) == Measures(None, 1.0)


def test_a_footprint_outside_the_frame_is_not_measured(view: View) -> None:
    assert measure(view, np.zeros((20, 20), np.uint8)) == Measures(None, None)
