"""A board for all formats, and the check of its marks against the layout."""

from __future__ import annotations

import re
from collections.abc import Callable
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.calibration.artwork import ArrayDesign, Board, design_board

Shapes = list[NDArray[Any]]


@pytest.fixture(scope="session")
def board() -> Board:
    """The example board of hw/calibration-board: three cameras."""
    return design_board(ArrayDesign(3, 33.143, (34.8, 26.0)))


@pytest.fixture(scope="session")
def numbers() -> Callable[[str], list[float]]:
    """All decimal numbers of a text."""

    def find(text: str) -> list[float]:
        return [float(v) for v in re.findall(r"-?\d+\.?\d*(?:e-?\d+)?", text)]

    return find


def _is_cross(corners: NDArray[Any], size: float, width: float) -> bool:
    q = np.abs(corners - corners.mean(0))
    return (
        len(q) == 12
        and np.allclose(np.sort(q, axis=1).min(0), (width / 2, width / 2), atol=1e-4)
        and bool(np.allclose(q.max(0), size / 2, atol=1e-4))
    )


@pytest.fixture(scope="session")
def check_marks(board: Board) -> Callable[[Shapes, tuple[float, float]], None]:
    """Asserts that marks are crosses within a micron of the layout."""

    def check(marks: Shapes, origin: tuple[float, float]) -> None:
        centers = np.array([m.mean(0) for m in marks])
        assert len(centers) == len(board.places_mm)
        assert np.abs(centers - (board.places_mm - origin)).max() < 1e-3
        assert all(_is_cross(m, 2.0, 0.5) for m in marks)

    return check
