"""The scatter of the heights of points on and beside components."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.stitching.adjustment.equations import (
    HeightScatter,
)
from vaoi_station.stitching.adjustment.problem import Problem, to_observations
from vaoi_station.stitching.matching.evidence import Links, Task


@pytest.fixture
def scattered(workshop: Any) -> HeightScatter:
    """Provide five links from row to row and five at a seam, each on: part 1, part 1, beside 1, beside 2, the board."""
    cameras, px = (workshop.camera(), workshop.camera()), np.arange(10.0).reshape(5, 2) + 100
    tasks = Task("rows", (0, 0), (0, 1)), Task("neighbours", (0, 0), (1, 0))
    found = [Links(task, px, px, np.tile(np.eye(2), (5, 1, 1)), np.ones(5)) for task in tasks]
    component, near = np.tile([1, 1, -1, -1, -1], 2), np.tile([1, 1, 1, 2, -1], 2)
    links = to_observations(found, cameras)
    problem = Problem(np.array([0.0, 0.1]), np.array([0.0, 50.0]), links, component, near=near)
    return HeightScatter(problem, np.where(component < 0, -1, component + 3 * (links.p == links.q)), 3)


def test_heights_on_and_beside_tall_components_scatter_in_proportion(scattered: HeightScatter) -> None:
    """The taller of both estimates counts: links between rows may lie on the leads."""
    single, mean = scattered.at(np.array([[0.0, 0.4, 1.5], [0.0, 2.5, 0.0]]))
    assert single == pytest.approx([0.75, 0.75, 1.16, 0.58, 0, 0.75, 0.75, 1.16, 0.58, 0])
    assert mean == pytest.approx(single * (single > 0) / 1.5)
