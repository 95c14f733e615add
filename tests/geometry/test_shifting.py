"""Resampling by runs of shifted pixels: equal to interpolation at the exact positions, and nothing beside the frame."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.geometry import apply
from vaoi_station.geometry.shifting import shift

UPRIGHT = np.array([[1.0025, -0.0021, -3.3], [0.0021, 0.9975, 2.6], [3e-7, -5e-7, 1.0]])


def waves(x: Any, y: Any) -> Any:
    return 120 + 60 * np.sin(x / 9) + 40 * np.cos(y / 7)


def frame_of(width: int, height: int, channels: int, dtype: Any) -> Any:
    y, x = np.mgrid[:height, :width].astype(float)
    scale = 1 if dtype == np.uint8 else 257
    grey = np.rint(np.stack([waves(x, y) + 5 * n for n in range(channels)], -1) * scale).astype(dtype)
    frame = grey.reshape(height, width * channels)
    frame.flags.writeable = False
    return frame


@pytest.mark.parametrize(("channels", "dtype"), [(1, np.uint8), (3, np.uint8), (1, np.uint16)])
@pytest.mark.parametrize("lean", [1.0, -1.0])
def test_values_are_those_at_the_exact_positions(channels: int, dtype: Any, lean: float) -> None:
    matrix = UPRIGHT.copy()
    matrix[0, 1], matrix[1, 0], matrix[0, 0] = -lean * 0.0021, lean * 0.0021, 1 + lean * 0.0025
    width, height, line = 200, 40, 210 * channels
    out = np.full(line * height + 5, 7, dtype)
    assert shift(frame_of(150, 60, channels, dtype), matrix, channels, out, (5, line, width, height), False)
    y, x = np.mgrid[:height, :width].astype(float)
    at = apply(matrix, np.stack([x, y], -1))
    inside = (at[..., 0] > 0) & (at[..., 1] > 0) & (at[..., 0] < 148.9) & (at[..., 1] < 58.9)
    beside = (at[..., 0] < 0) | (at[..., 1] < 0) | (at[..., 0] > 149) | (at[..., 1] > 59)
    found = out[5:].reshape(height, -1, channels)[:, :width] / (1 if dtype == np.uint8 else 257)
    for n in range(channels):
        assert np.abs(found[..., n] - waves(at[..., 0], at[..., 1]) - 5 * n)[inside].max() < 1.2
    assert inside.any()
    assert (found[beside] == 0).all()
    assert (out[:5] == 7).all(), "written before the rectangle"
    assert (out[5:].reshape(height, -1)[:, width * channels :] == 7).all(), "written beside the rectangle"


def resampled(matrix: Any, whole: bool = False) -> Any:
    """Return a picture of 100 × 100 px, or None if it was not made."""
    out = np.full(100 * 100, 7, np.uint8)
    if not shift(frame_of(150, 130, 1, np.uint8), matrix, 1, out, (0, 100, 100, 100), whole):
        assert (out == 7).all()
        return None
    return out.reshape(100, 100)


def test_turned_and_scaled_frames_are_no_shift() -> None:
    assert resampled(np.eye(3)) is not None
    assert resampled(np.array([[0.0, -1, 100], [1, 0, 0], [0, 0, 1]])) is None
    assert resampled(np.diag([1.1, 1.1, 1.0])) is None
    assert resampled(np.array([[1.0, 0, 0], [0, 1, 0], [1e-4, 0, 1]])) is None
    assert resampled(np.array([[1.0, 0, 0], [0, 1, 0], [0, -0.02, 1]])) is None


@pytest.mark.parametrize(("x", "y", "shown"), [(0, 0, True), (49.9, 29.9, True), (50, 0, False), (0, -0.1, False)])
def test_whole_pictures_lie_in_the_frame_with_all_neighbours(x: float, y: float, shown: bool) -> None:
    picture = resampled(np.array([[1.0, 0, x], [0, 1, y], [0, 0, 1]]), whole=True)
    assert (picture is not None) == shown
    assert picture is None or (picture > 0).all()
