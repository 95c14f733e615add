"""Homographies of rectangles, and tiles that follow a lens."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.geometry import Camera, Lens, Projective, System, apply
from vaoi_station.rendering.tiles import cut_tiles, rectangle_homographies, through

MATRIX = np.array([[1.02, 0.03, 20.0], [-0.02, 0.97, 15.0], [2e-5, -3e-5, 1.0]])


def test_a_homography_takes_the_corners_to_their_points() -> None:
    random = np.random.default_rng(3)
    boxes = np.array([[0, 0, 99, 49], [-0.5, -0.5, 30, 20], [7, 9, 400, 12]], dtype=float)
    x0, y0, x1, y1 = boxes.T
    source = np.stack([x0, y0, x1, y0, x1, y1, x0, y1], -1).reshape(-1, 4, 2)
    target = np.stack([apply(MATRIX, s) for s in source]) + random.normal(0, 0.5, (3, 4, 2))
    found = rectangle_homographies(source, target)
    np.testing.assert_allclose(through(found, source), target, atol=1e-9)
    np.testing.assert_allclose(found[:, 2, 2], 1)


def test_a_rectangle_without_area_has_no_homography() -> None:
    source = np.array([[[0, 0], [0, 0], [0, 9], [0, 9]]], dtype=float)
    assert np.isnan(rectangle_homographies(source, source + 1)).any()


@pytest.mark.parametrize("bend_px", [0.03, 0.4, np.inf])
def test_tiles_follow_the_lens(bend_px: float) -> None:
    """A lens of 1 px at the corner of the frame, in a picture of nearly the whole frame."""
    n = Projective(np.diag([8.0, 8.0, 1.0]), System.IMAGE, System.ROW)
    camera = Camera(640, 480, n, Lens((319.5, 239.5), 400.0, (0.0025,)))
    size = np.array([[560.0, 400.0], [40.0, 30.0]])
    bends = np.array([bend_px, bend_px])
    [whole, small] = cut_tiles(np.stack([MATRIX, MATRIX]), size, bends, lambda _, points: camera.lens.distort(points))
    assert len(whole) >= len(small) >= 4
    covered = np.zeros((400, 560), dtype=int)
    for tile in whole:
        covered[tile.y0 : tile.y1, tile.x0 : tile.x1] += 1
        y, x = np.mgrid[tile.y0 : tile.y1, tile.x0 : tile.x1]
        at = np.stack([x, y], -1).reshape(-1, 2).astype(float)
        exact = camera.lens.distort(apply(MATRIX, at))
        if bend_px >= 0.4:
            assert np.abs(apply(tile.matrix, at - (tile.x0, tile.y0)) - exact).max() < 0.01
    assert (covered == 1).all()
