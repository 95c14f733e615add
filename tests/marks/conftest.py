"""Pictures of marks, exact: every pixel is a mean over many points of the shape itself."""

from __future__ import annotations

from collections.abc import Callable

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

_FINE = 8
"""Points per axis within a pixel."""

Picture = NDArray[np.uint8]
Light = Callable[[NDArray[np.float64], NDArray[np.float64]], NDArray[np.float64]]
"""Brightness at the points (x, y), before the camera's blur."""


def covered(shape: str, x: NDArray[np.float64], y: NDArray[np.float64], size: float) -> NDArray[np.float64]:
    """Share of fine cells about points that a mark about the origin covers, by its definition."""
    x, y, r = np.abs(x), np.abs(y), size / 2

    def within(beyond: NDArray[np.float64]) -> NDArray[np.float64]:
        return np.clip(0.5 - beyond * _FINE, 0, 1)

    if shape == "circle":
        return within(np.hypot(x, y) - r)
    if shape == "square":
        return within(x - r) * within(y - r)
    if shape == "diamond":
        return within((x + y - r) / np.sqrt(2))
    return np.maximum(within(x - r) * within(y - r / 4), within(x - r / 4) * within(y - r))


@pytest.fixture(scope="session")
def paint() -> Callable[..., Picture]:
    """Marks [(shape, x, y, size)] on a plain ground, under a light, with a camera's blur, in whole grey levels."""

    def make(
        marks: list[tuple[str, float, float, float]],
        *,
        size: tuple[int, int] = (96, 80),
        mark: float = 210.0,
        ground: float = 60.0,
        noise: float = 0.0,
        blur_px: float = 0.6,
        light: Light | None = None,
    ) -> Picture:
        w, h = size
        at_x = (np.arange(w * _FINE) + 0.5) / _FINE - 0.5
        at_y = (np.arange(h * _FINE) + 0.5) / _FINE - 0.5
        fine = np.full((h * _FINE, w * _FINE), ground)
        for shape, x, y, extent in marks:
            fine += (mark - ground) * covered(shape, at_x[None] - x, at_y[:, None] - y, extent)
        if light:
            fine *= light(at_x[None], at_y[:, None])
        smooth = cv2.GaussianBlur(fine, (0, 0), blur_px * _FINE) if blur_px else fine
        grey = smooth.reshape(h, _FINE, w, _FINE).mean((1, 3))
        grey += np.random.default_rng(1).normal(0, noise, grey.shape) if noise else 0
        return np.asarray(np.clip(np.round(grey), 0, 255), dtype=np.uint8)

    return make
