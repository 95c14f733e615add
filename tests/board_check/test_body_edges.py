"""The edges of bodies as points."""

from __future__ import annotations

import math

import numpy as np
import pytest

from vaoi_station.board_check.body_edges import BodyEdges
from vaoi_station.model import BoardType


def test_edges_of_bodies_have_normals_and_equal_shares(board: BoardType) -> None:
    edges = BodyEdges.of(board)
    assert np.hypot(*edges.normals.T) == pytest.approx(1.0)
    first = edges.part == 0
    part = board.components[0]
    reach = np.abs(edges.points[first] - part.center)
    assert reach.max() == pytest.approx(max(part.width, part.height) / 2, abs=1e-9)
    perimeter = 2 * (part.width + part.height)
    assert edges.weight[first].sum() == pytest.approx(math.sqrt(perimeter))
    assert set(edges.of_parts(np.array([3, 4])).part.tolist()) == {3, 4}
