"""The centre of symmetry of a component's picture, found to a fraction of a pixel."""

from __future__ import annotations

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.stitching.components.centres import centre_of_symmetry

PX_PER_MM = 16.0
HALF = np.array([20.0, 9.0])
"""Half the extent of a chip's footprint, px."""


def picture(x: float, y: float, scale: float = 1.0, noise: float = 2.0) -> NDArray[np.uint8]:
    """Draw a chip with two pads about (x, y), beside a trace and a dot that are not symmetric to it."""
    fine, shape = 8, (160, 200)
    v, u = (np.mgrid[: shape[0] * fine, : shape[1] * fine] + 0.5) / fine - 0.5
    levels = np.full(u.shape, 70.0)
    levels[(np.abs(u - x + v - y - 34) < 2) | (np.hypot(u - x + 12, v - y + 14) < 3)] = 120.0
    levels[(np.abs(u - x) < 20 * scale) & (np.abs(v - y) < 9 * scale)] = 200.0
    levels[(np.abs(u - x) < 12 * scale) & (np.abs(v - y) < 8 * scale)] = 30.0
    small = cv2.GaussianBlur(cv2.resize(levels, shape[::-1], interpolation=cv2.INTER_AREA), (0, 0), 0.8)
    noisy = small + np.random.default_rng(3).normal(0, noise, shape)
    return np.asarray(np.clip(np.rint(noisy), 0, 255), np.uint8)


@pytest.mark.parametrize(("x", "y"), [(100.0, 80.0), (101.3, 79.2), (97.6, 82.1)])
def test_a_chip_is_found_to_a_tenth_of_a_pixel(x: float, y: float) -> None:
    place = np.array([99.7, 80.4])
    off = centre_of_symmetry(picture(x, y), place, HALF, PX_PER_MM)
    assert off is not None
    assert np.array(off) + place == pytest.approx((x, y), abs=0.15)


def row_of_chips(count: int) -> NDArray[np.uint8]:
    """Draw chips 0805 with a frame of silkscreen each, 1.875 mm apart; the first is about (100.2, 60.4)."""
    fine, shape = 8, (220, 200)
    v, u = (np.mgrid[: shape[0] * fine, : shape[1] * fine] + 0.5) / fine - 0.5
    levels = np.full(u.shape, 55.0)
    for n in range(count):
        x, y = np.abs(u - 100.2) / PX_PER_MM, np.abs(v - 60.4 - n * 1.875 * PX_PER_MM) / PX_PER_MM
        levels[(np.abs(x - 1.18) < 0.065) & (y < 0.87) | (np.abs(y - 0.805) < 0.065) & (x < 1.24)] = 205.0
        levels[(x < 1.35) & (x > 0.75) & (y < 0.65)] = 172.0
        levels[(x < 1.0) & (y < 0.625)] = 120.0
        levels[(x < 1.0) & (x > 0.7) & (y < 0.625)] = 190.0
    small = cv2.GaussianBlur(cv2.resize(levels, shape[::-1], interpolation=cv2.INTER_AREA), (0, 0), 0.8)
    noisy = small + np.random.default_rng(4).normal(0, 2, shape)
    return np.asarray(np.clip(np.rint(noisy), 0, 255), np.uint8)


@pytest.mark.parametrize("off_px", [(0.0, 0.0), (1.3, -0.8), (-0.6, 1.7)])
@pytest.mark.parametrize("at", [0, 1, 3])
def test_neighbours_do_not_draw_a_chip_to_themselves(at: int, off_px: tuple[float, float]) -> None:
    """The chips at both ends of a row have a neighbour on one side only."""
    true = np.array([100.2, 60.4 + at * 1.875 * PX_PER_MM])
    place = true - off_px
    found = centre_of_symmetry(row_of_chips(4), place, np.array([1.35, 0.6875]) * PX_PER_MM, PX_PER_MM)
    assert found is not None
    assert np.array(found) == pytest.approx(off_px, abs=0.5)


def test_a_large_component_is_found_in_a_reduced_picture() -> None:
    place = np.array([100.0, 80.0])
    off = centre_of_symmetry(picture(101.5, 81.2, 2.2), place, 2.2 * HALF, PX_PER_MM)
    assert off is not None
    assert np.array(off) + place == pytest.approx((101.5, 81.2), abs=0.3)


def test_no_centre_where_nothing_is_symmetric() -> None:
    flat = np.full((160, 200), 90, np.uint8)
    assert centre_of_symmetry(flat, np.array([100.0, 80.0]), HALF, PX_PER_MM) is None
    g = np.random.default_rng(1)
    blotches = np.clip(cv2.GaussianBlur(g.normal(0, 1, (160, 200)), (0, 0), 3) * 300 + 100, 0, 255).astype(np.uint8)
    assert centre_of_symmetry(blotches, np.array([100.0, 80.0]), HALF, PX_PER_MM) is None


def test_no_centre_at_the_border_or_beyond_the_reach_or_for_a_huge_footprint() -> None:
    chip = picture(100.0, 80.0)
    assert centre_of_symmetry(picture(15.0, 80.0), np.array([15.0, 80.0]), HALF, PX_PER_MM) is None
    assert centre_of_symmetry(chip, np.array([100.0 - 0.5 * PX_PER_MM, 80.0]), HALF, PX_PER_MM) is None
    assert centre_of_symmetry(chip, np.array([100.0, 80.0]), 10 * HALF, PX_PER_MM) is None
