"""Pictures of known blur."""

from __future__ import annotations

from typing import Any

import cv2
import numpy as np
import pytest
from numpy.typing import NDArray

FINE = 4
"""Factor by which pictures are drawn finer and then reduced: the pixel width is part of the blur."""


class Painter:
    """Draws frames."""

    def tilted_board(self, blur_px: float, noise: float = 0.0, size: tuple[int, int] = (480, 360)) -> NDArray[np.uint8]:
        """A checker board, turned a little, with a blur of known standard deviation, the pixel's width included."""
        w, h = (side * FINE for side in size)
        y, x = np.mgrid[:h, :w].astype(np.float32) / FINE
        u, v = (x * np.cos(0.2) + y * np.sin(0.2)) / 37, (y * np.cos(0.2) - x * np.sin(0.2)) / 37
        levels = np.where((np.floor(u) + np.floor(v)) % 2 > 0, 200.0, 50.0).astype(np.float32)
        lens = float(np.sqrt(max(blur_px**2 - 1 / 12, 1e-4)) * FINE)
        blurred = cv2.GaussianBlur(levels, (0, 0), lens)
        return self.exposed(cv2.resize(blurred, size, interpolation=cv2.INTER_AREA), noise)

    @staticmethod
    def exposed(levels: NDArray[Any], noise: float) -> NDArray[np.uint8]:
        random = np.random.default_rng(7)
        return np.asarray(np.clip(np.rint(levels + random.normal(0, noise, levels.shape)), 0, 255), np.uint8)


@pytest.fixture(scope="session")
def painter() -> Painter:
    return Painter()
