from __future__ import annotations

import re
from pathlib import Path
from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.calibration.artwork import (
    Board,
    render_gerber_marks,
    render_gerber_outline,
)
from vaoi_station.files.calibrations import read_layout

Shapes = list[NDArray[Any]]
EXAMPLE = Path(__file__).parents[3] / "hw" / "calibration-board"


def _read_gerber(document: str) -> tuple[NDArray[Any], tuple[float, float], Shapes]:
    """Flashes (k, 2) in mm, the aperture's size and width, and the strokes drawn."""
    assert "%FSLAX46Y46*%" in document
    assert "%MOMM*%" in document
    assert document.rstrip().endswith("M02*")
    size, width = (float(v) for v in re.findall(r"%ADD10CROSS,([\d.]+)X([\d.]+)\*%", document)[0])
    flashes, strokes, at = [], [], np.zeros(2)
    for x, y, code in re.findall(r"X(-?\d+)Y(-?\d+)D0([123])\*", document):
        to = np.array([int(x), int(y)]) / 1e6
        if code == "3":
            flashes.append(to)
        elif code == "1":
            strokes.append(np.array([at, to]))
        at = to
    return np.array(flashes), (size, width), strokes


def test_marks_are_flashed_with_y_up(board: Board) -> None:
    flashes, aperture, strokes = _read_gerber(render_gerber_marks(board))
    assert np.abs(flashes - board.places_mm * (1, -1)).max() < 1e-3
    assert aperture == (2.0, 0.5)
    assert np.hypot(*(strokes[0][1] - strokes[0][0])) == pytest.approx(50.0)


def test_the_example_is_what_the_software_makes_now(board: Board) -> None:
    assert read_layout(EXAMPLE / "layout.json") == board.layout
    assert (EXAMPLE / "calibration-board.gbr").read_text() == render_gerber_marks(board)
    assert (EXAMPLE / "calibration-board-outline.gbr").read_text() == render_gerber_outline(board)
