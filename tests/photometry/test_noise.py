from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.photometry.noise import is_saturated, noise_from_frames


def noisy(level: NDArray[np.float64], read: float, shot: float, seed: int) -> NDArray[np.uint8]:
    noise = np.random.default_rng(seed).standard_normal(level.shape) * np.sqrt(read**2 + shot * level)
    return np.clip(np.round(level + noise), 0, 255).astype(np.uint8)


def board(seed: int, bright: float) -> NDArray[np.float64]:
    """Smooth places of all brightnesses, and busy ones in half of the frame."""
    rng = np.random.default_rng(seed)
    level = np.kron(rng.uniform(10, 230, (10, 12)), np.ones((48, 48)))
    level[:, :288] *= np.kron(rng.uniform(0.6, 1, (120, 72)), np.ones((4, 4)))
    return np.asarray(level * bright, dtype=np.float64)


def test_noise_is_estimated_from_the_smooth_places_of_frames() -> None:
    frames = [noisy(board(k, bright), 1.5, 0.03, k) for k, bright in enumerate((1.0, 0.5, 0.2))]
    found = noise_from_frames(frames)
    assert found.read == pytest.approx(1.5, abs=0.25)
    assert found.shot == pytest.approx(0.03, rel=0.25)


@pytest.mark.parametrize(("dtype", "full"), [(np.uint8, 255), (np.uint16, 65535)])
def test_saturated_pixels_and_their_neighbours_are_not_used(dtype: type, full: int) -> None:
    pixels: NDArray[Any] = np.full((7, 9), full // 2, dtype)
    pixels[3, 4] = full
    assert is_saturated(pixels).sum() == 9
    assert is_saturated(pixels)[2:5, 3:6].all()
