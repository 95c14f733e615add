"""Projection into frames: exact at the corners of a part, and the box that a frame shows."""

from __future__ import annotations

import numpy as np
import pytest

from tests.mosaic.conftest import Filmed
from vaoi_station.errors import StateError
from vaoi_station.frame_index import FrameIndex
from vaoi_station.geometry import apply
from vaoi_station.geometry.homographies import between
from vaoi_station.mosaic.reduction import shrunk


def test_matrix_of_a_part_agrees_with_the_projection(board: Filmed) -> None:
    projector, grid = board.projector, board.base
    matrix = projector.matrix(1, 2, grid.cad_from_mosaic, (100, 60, 356, 300))
    for at in [(99.5, 59.5), (355.5, 299.5), (200.0, 150.0)]:
        exact = projector.raw_px(1, 2, apply(grid.cad_from_mosaic, at))
        assert apply(matrix, at) == pytest.approx(exact, abs=1e-6)


def test_box_encloses_what_a_frame_shows(board: Filmed) -> None:
    projector, grid = board.projector, board.base
    x0, y0, x1, y1 = projector.seen_box(0, 1, *grid.place)
    y, x = np.mgrid[: grid.height, : grid.width]
    raw = projector.raw_px(0, 1, apply(grid.cad_from_mosaic, np.stack([x, y], -1).astype(float)))
    seen = projector.cameras[0].sees(raw)
    assert seen[y0:y1, x0:x1].sum() == seen.sum() > 0
    assert (y1 - y0) * (x1 - x0) < 1.1 * seen.sum()


def test_run_without_cad_mapping_is_refused(board: Filmed) -> None:
    with pytest.raises(StateError, match="no CAD mapping"):
        FrameIndex.of_result(board.stitch.model_copy(update={"cad_matrix": None}), board.cameras)


def test_matrices_between_reduced_grids_keep_places() -> None:
    matrix = np.array([[2, 0, 5], [0, 2, 7], [0, 0, 1.0]])
    small = between(matrix, 4, 8)
    # the corner (−0.5, −0.5) of the source is the corner of a reduced source
    assert (apply(small, (-0.5, -0.5)) + 0.5) * 4 - 0.5 == pytest.approx(apply(matrix, (-0.5, -0.5)))


def test_shrunk_pictures_are_means_of_blocks() -> None:
    picture = np.arange(35, dtype=np.float32).reshape(5, 7)
    assert shrunk(picture, 2)[1, 2] == pytest.approx(picture[2:4, 4:6].mean())
    assert shrunk(picture, 2).shape == (2, 3)
    assert shrunk(picture, 1) is picture
