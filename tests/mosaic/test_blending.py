"""The inner loops: corrections between the centres of cells, weights, and borders of the frame."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.mosaic.blending import Corrections, add_frame, finish, nodes_along

WIDE = np.array([-1e6, -1e6, 1e6, 1e6])


def test_corrections_are_interpolated_between_cells() -> None:
    factor = np.array([[1, 2], [3, 4]], np.float32)
    mine = np.array([[1, 0], [1, 0]], np.float32)
    x, y = nodes_along(0.0, 0.25, 5, 2), nodes_along(0.0, 0.5, 3, 2)
    total, weights = np.zeros((6, 8), np.float32), np.zeros((6, 8), np.float32)
    pixels = np.full((3, 5), 12, np.uint8)
    add_frame(total, weights, pixels, x, y, Corrections(factor, mine, np.eye(3), WIDE, 2.0), (2, 1))
    share, down = np.arange(5) * 0.25, np.arange(3)[:, None] * 0.5
    np.testing.assert_allclose(weights[1:4, 2:7], np.broadcast_to(1 - share, (3, 5)), atol=1e-6)
    np.testing.assert_allclose(total[1:4, 2:7], (1 - share) * 10 * (1 + share + 2 * down), atol=1e-4)
    assert (weights[0] == 0).all()
    assert (weights[:, 7] == 0).all()


@pytest.mark.parametrize("turned", [np.eye(3), np.diag([-1.0, -1.0, -1.0]), np.diag([-1.0, 1.0, 1.0])])
def test_pixels_beside_the_frame_are_left_out(turned: np.ndarray) -> None:
    one = np.ones((2, 2), np.float32)
    nodes = nodes_along(0.0, 0.1, 8, 2)
    total, weights = np.zeros((8, 8), np.float32), np.zeros((8, 8), np.float32)
    matrix = turned if turned[2, 2] > 0 else -turned
    limits = np.array([2.0, 3.0, 5.0, 6.0]) if matrix[0, 0] > 0 else np.array([-5.0, 3.0, -2.0, 6.0])
    corrections = Corrections(one, one, matrix, limits, 0.0)
    add_frame(total, weights, np.ones((8, 8), np.uint8), nodes, nodes, corrections, (0, 0))
    expected = np.zeros((8, 8))
    expected[3:7, 2:6] = 1
    np.testing.assert_array_equal(weights, expected)


def test_grey_levels_are_rounded_and_what_is_shown_is_at_least_one() -> None:
    out = np.empty((1, 5), np.uint8)
    finish(np.array([[5.2, 1.4, -3.0, 900.0, 0.0]], np.float32), np.array([[2, 1, 1, 1, 0]], np.float32), 255.0, out)
    assert out.tolist() == [[3, 1, 1, 255, 0]]


def test_nodes_end_at_the_last_cell() -> None:
    nodes = nodes_along(-0.5, 1.0, 4, 3)
    assert (nodes.cell + nodes.share).tolist() == [0.0, 0.5, 1.5, 2.0]
    assert nodes_along(0.0, 1.0, 2, 1).cell.tolist() == [0, 0]
