from __future__ import annotations

import pytest

from vaoi_station.calibration.artwork import Board
from vaoi_station.calibration.artwork.artwork_files import RENDERERS, array_of, artwork_title
from vaoi_station.model import CameraHead


def test_every_file_is_made_of_one_board(board: Board) -> None:
    title = artwork_title(board, 33.143)
    assert title == f"3 x 33.143 mm, {len(board.layout.marks)} marks"
    made = {name: render(board, title) for name, render in RENDERERS.items()}
    assert made["calibration-board.svg"].startswith(b"<?xml")
    assert made["calibration-board.pdf"].startswith(b"%PDF")
    assert all(content.rstrip().endswith(b"M02*") for name, content in made.items() if name.endswith(".gbr"))


def test_an_array_is_that_of_nominal_values() -> None:
    def head(x: float | None, px: float | None, width: int = 400) -> CameraHead:
        center = None if x is None else (x, 0.0)
        return CameraHead(width=width, height=300, exposure_us=1.0, nominal_center_mm=center, nominal_px_per_mm=px)

    pitch, field = array_of([head(0, 10), head(30, 20, 500)])
    assert pitch == 30.0
    assert field == pytest.approx((20.0, 15.0))
    assert array_of([head(0, None), head(None, 10)]) == (None, None)
    assert array_of([head(0, None)], 40.0) == (None, (10.0, 7.5))
