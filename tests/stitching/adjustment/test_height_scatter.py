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


def test_heights_of_low_components_scatter_by_a_constant(scattered: HeightScatter) -> None:
    single, mean = scattered.at(np.array([[0.0, 0.4, -0.2], [0.0, 0.3, 0.5]]))
    assert single == pytest.approx([0.3, 0.3, 0, 0, 0, 0.3, 0.3, 0.1, 0.1, 0])
    assert mean == pytest.approx([0.2, 0.2, 0, 0, 0, 0.2, 0.2, 0.2, 0.2, 0])


def test_heights_on_and_beside_tall_components_scatter_in_proportion(scattered: HeightScatter) -> None:
    """The taller of both estimates counts: links between rows may lie on the leads."""
    single, mean = scattered.at(np.array([[0.0, 0.4, 1.5], [0.0, 2.5, 0.0]]))
    assert single == pytest.approx([0.75, 0.75, 1.16, 0.58, 0, 0.75, 0.75, 1.16, 0.58, 0])
    assert mean == pytest.approx(single * (single > 0) / 1.5)


def test_links_have_their_heights_in_common_by_component_and_pair_of_frames(scattered: HeightScatter) -> None:
    """At a seam, the sides of all components are one cell."""
    rows, seam = scattered.cell[:5].tolist(), scattered.cell[5:].tolist()
    assert rows[4] == seam[4] == -1
    assert rows[0] == rows[1]
    assert seam[0] == seam[1]
    assert seam[2] == seam[3]
    assert len({rows[0], rows[2], rows[3], seam[0], seam[2]}) == 5
