"""The file of a whole board: levels, colours, values, and frames that are read once."""

from __future__ import annotations

from dataclasses import replace
from pathlib import Path

import numpy as np
import tifffile

from tests.mosaic.conftest import Film, Filmed
from tests.mosaic.test_plan import plan_of
from vaoi_station.mosaic.whole_board import FrameCache, write_mosaic


def test_file_has_the_pixels_of_the_mosaic(board: Filmed, tmp_path: Path) -> None:
    layout = write_mosaic(tmp_path / "b.tif", plan_of(board), board.projector, board.base, board.read)
    with tifffile.TiffFile(tmp_path / "b.tif") as file:
        series = file.series[0]
        assert (len(series.levels), file.pages.first.is_tiled) == (layout.levels, True)
        assert series.levels[0].shape == (400, 520)
        assert (series.levels[0].asarray() > 0).all()
    assert [p.name for p in tmp_path.iterdir()] == ["b.tif"]


def test_colours_are_red_green_blue(film: Film, tmp_path: Path) -> None:
    dimmed = np.array([2, 1, 1], np.uint8)  # blue first, the order of OpenCV
    filmed = film(channels=3)
    board = replace(filmed, frames={key: pixels // dimmed for key, pixels in filmed.frames.items()})
    write_mosaic(tmp_path / "b.tif", plan_of(board), board.projector, board.base, board.read)
    colour = tifffile.imread(tmp_path / "b.tif").reshape(-1, 3).mean(0)
    assert colour[2] < 0.7 * colour[0]


def test_frames_are_kept_up_to_a_number_of_bytes() -> None:
    read: list[tuple[int, int]] = []

    def frame(camera: int, row: int) -> np.ndarray:
        read.append((camera, row))
        return np.zeros(100, np.uint8)

    cache = FrameCache(frame, most_bytes=250)
    for key in [(0, 0), (0, 1), (0, 0), (0, 2), (0, 0), (0, 1)]:
        cache(*key)
    assert read == [(0, 0), (0, 1), (0, 2), (0, 1)]
