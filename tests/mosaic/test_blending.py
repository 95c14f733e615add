"""The inner loop: corrections between the centres of cells, weights, and borders of the frames."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.mosaic.blending import Cells, Nodes, Pictures, blend, nodes_along

WIDE = np.array([-1e6, -1e6, 1e6, 1e6])


def pictures_of(
    frames: list[Any], dark: float = 0.0, matrix: np.ndarray | None = None, limits: np.ndarray = WIDE
) -> Pictures:
    """Frames that all begin at the tile's first pixel."""
    place = [(n * frames[0].size, 0, 0, frames[0].shape[1]) for n in range(len(frames))]
    count = len(frames)
    return Pictures(
        np.concatenate([frame.ravel() for frame in frames]),
        np.array(place),
        np.full(count, dark, np.float32),
        np.stack([np.eye(3) if matrix is None else matrix] * count),
        np.stack([limits] * count),
    )


def one_frame(shape: tuple[int, int], factor: float = 1.0) -> Cells:
    return Cells(np.zeros(shape, np.int32), np.full(shape, factor, np.float32))


def test_corrections_are_interpolated_between_cells() -> None:
    cells = Cells(np.zeros((2, 2), np.int32), np.array([[1, 2], [3, 4]], np.float32))
    x, y = nodes_along(0.0, 0.25, 5, 2), nodes_along(0.0, 0.5, 3, 2)
    out = np.empty((3, 5), np.uint8)
    blend(pictures_of([np.full((3, 5), 22, np.uint8)], dark=2.0), cells, x, y, 1, 255.0, out)
    share, down = np.arange(5) * 0.25, np.arange(3)[:, None] * 0.5
    np.testing.assert_array_equal(out, 20 * (1 + share + 2 * down))


@pytest.mark.parametrize("channels", [1, 3])
def test_frames_change_over_one_cell(channels: int) -> None:
    cells = Cells(np.array([[0, 1, 1]] * 2, np.int32), np.ones((2, 3), np.float32))
    x, y = nodes_along(0.0, 0.25, 9, 3), nodes_along(0.0, 0.5, 3, 2)
    every = Nodes(np.repeat(x.cell, channels), np.repeat(x.share, channels))
    frames = [np.full((3, 9, channels), grey, np.uint8) for grey in (100, 200)]
    out = np.empty((3, 9 * channels), np.uint8)
    blend(pictures_of(frames), cells, every, y, channels, 255.0, out)
    expected = np.repeat([100, 125, 150, 175, 200, 200, 200, 200, 200], channels)
    np.testing.assert_array_equal(out, np.broadcast_to(expected, out.shape))


def test_cells_without_a_frame_take_the_neighbour_up_to_their_centre() -> None:
    cells = Cells(np.array([[0, -1, -1]] * 2, np.int32), np.ones((2, 3), np.float32))
    x, y = nodes_along(0.0, 0.25, 9, 3), nodes_along(0.0, 0.5, 3, 2)
    out = np.empty((3, 9), np.uint8)
    blend(pictures_of([np.full((3, 9), 50, np.uint8)]), cells, x, y, 1, 255.0, out)
    np.testing.assert_array_equal(out, np.broadcast_to([50] * 4 + [0] * 5, (3, 9)))


@pytest.mark.parametrize("turned", [np.eye(3), np.diag([-1.0, -1.0, -1.0]), np.diag([-1.0, 1.0, 1.0])])
def test_pixels_beside_the_frame_are_left_out(turned: np.ndarray) -> None:
    nodes = nodes_along(0.0, 0.1, 8, 2)
    matrix = turned if turned[2, 2] > 0 else -turned
    limits = np.array([2.0, 3.0, 5.0, 6.0]) if matrix[0, 0] > 0 else np.array([-5.0, 3.0, -2.0, 6.0])
    out = np.empty((8, 8), np.uint8)
    frame = np.ones((8, 8), np.uint8)
    blend(pictures_of([frame], 0.0, matrix, limits), one_frame((2, 2)), nodes, nodes, 1, 255.0, out)
    expected = np.zeros((8, 8))
    expected[3:7, 2:6] = 1
    np.testing.assert_array_equal(out, expected)


def test_grey_levels_are_rounded_and_what_is_shown_is_at_least_one() -> None:
    out = np.empty((1, 4), np.uint8)
    x, y = nodes_along(0.0, 0.0, 4, 1), nodes_along(0.0, 1.0, 1, 1)
    frame = np.array([[7, 2, 0, 250]], np.uint8)
    blend(pictures_of([frame], dark=1.0), one_frame((1, 1), 1.1), x, y, 1, 255.0, out)
    assert out.tolist() == [[7, 1, 1, 255]]


def test_nodes_end_at_the_last_cell() -> None:
    nodes = nodes_along(-0.5, 1.0, 4, 3)
    assert (nodes.cell + nodes.share).tolist() == [0.0, 0.5, 1.5, 2.0]
    assert nodes_along(0.0, 1.0, 2, 1).cell.tolist() == [0, 0]
