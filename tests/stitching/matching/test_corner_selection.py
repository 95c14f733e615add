"""Corner selection agrees with OpenCV's corner score and a few lines of numpy."""

from __future__ import annotations

import cv2
import numpy as np
from hypothesis import given, settings
from hypothesis import strategies as st
from numpy.typing import NDArray

from vaoi_station.stitching.matching.frames import read_only
from vaoi_station.stitching.matching.link import best_corners


def image(seed: int) -> NDArray[np.uint8]:
    g = np.random.default_rng(seed)
    soft = cv2.GaussianBlur(g.normal(128, 120, (60, 90)), (0, 0), 1.5)
    return np.asarray(np.clip(soft, 0, 255), dtype=np.uint8)


@settings(deadline=None)
@given(
    seed=st.integers(0, 1000),
    corner=st.tuples(st.integers(0, 30), st.integers(0, 20)),
    across=st.tuples(st.integers(1, 6), st.integers(1, 10)),
    down=st.tuples(st.integers(1, 4), st.integers(1, 10)),
)
def test_the_best_pixel_of_every_cell_is_that_of_opencv(
    seed: int, corner: tuple[int, int], across: tuple[int, int], down: tuple[int, int]
) -> None:
    grey, (x0, y0) = image(seed), corner
    score = cv2.cornerMinEigenVal(grey, 3, ksize=3)
    score[:2] = score[-2:] = score[:, :2] = score[:, -2:] = 0  # OpenCV mirrors what lies beyond the border
    (nx, width), (ny, height) = across, down
    cells = score[y0 : y0 + ny * height, x0 : x0 + nx * width].reshape(ny, height, nx, width)
    best = cells.max((1, 3)).ravel()
    found = best_corners(read_only(grey), x0, y0, across, down)
    least = max(0.003 * np.sort(best)[int(len(best) * 0.9)], 1e-5)
    assert abs(len(found) - (best > least).sum()) <= (np.abs(best - least) < 1e-7).sum()
    cell = (found[:, 1] - y0) // height * nx + (found[:, 0] - x0) // width
    assert len(set(cell.tolist())) == len(cell)
    np.testing.assert_allclose(score[found[:, 1], found[:, 0]], best[cell], rtol=1e-3, atol=1e-7)


def test_flat_grey_has_no_corners() -> None:
    assert not len(best_corners(read_only(np.full((60, 90), 77, np.uint8)), 10, 10, (4, 8), (4, 8)))
