"""Heights of components: which unknowns they are coupled to, their prior, their elimination."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from numpy.typing import NDArray

from vaoi_station.stitching.adjustment.envelope import Envelope, add_equations
from vaoi_station.stitching.adjustment.equations import (
    Coupling,
    HeightScatter,
    OtherColumns,
    eliminate_heights,
    height_changes,
)
from vaoi_station.stitching.adjustment.problem import CameraPairs, LinkArrays, Problem, to_observations
from vaoi_station.stitching.matching.evidence import Links, Task

ROWS, BASIS, CAMERAS, PARTS = 4, 2, 3, 5
AT_CAMERAS = 3 * ROWS + 4 + BASIS
"""Four unknowns of C stand between rows and surface."""
SIZE = AT_CAMERAS + 3 * CAMERAS


def coupled(component: list[int], p: list[int], q: list[int], left: list[int], *, exact: bool = False) -> Coupling:
    """Couple links, each in a group of its own, between rows p and q; cameras differ if p = q."""
    k = len(component)
    none, rows = np.zeros((k, 2)), (np.array(p), np.array(q))
    links = LinkArrays(*rows, none, none, none, none, np.zeros((k, 2, 2)), np.ones(k), np.ones(k), np.arange(k))
    pairs = CameraPairs(np.array(left), np.array(left) + (rows[0] == rows[1]))
    columns = OtherColumns(BASIS, 3 * ROWS + 4, -1 if exact else AT_CAMERAS, PARTS)
    return Coupling.of(np.array(component), links, pairs, columns)


def test_a_component_is_coupled_to_the_rows_and_cameras_of_its_links() -> None:
    tied = coupled([1, 1, 3, -1], [0, 1, 2, 0], [1, 1, 3, 3], [0, 1, 2, 0])
    assert tied.row.tolist() == [0, 0, 0, 2, 0]
    assert tied.last.tolist() == [-1, 1, -1, 3, -1]
    assert tied.camera[[1, 3]].tolist() == [0, 2]
    assert np.diff(tied.at).tolist() == [0, 6 + BASIS + 9, 0, 6 + BASIS + 3, 0]


def test_with_exact_cameras_there_is_no_coupling_to_them() -> None:
    tied = coupled([1, 1], [0, 1], [1, 1], [0, 1], exact=True)
    assert np.diff(tied.at).tolist() == [0, 6 + BASIS, 0, 0, 0]


def test_the_prior_pulls_heights_to_zero() -> None:
    tied = coupled([1, 3], [0, 2], [1, 3], [0, 1])
    heights = tied.equations(np.array([0.0, 1.0, -2.0, 0.0, 0.0]), 0.5, 0.1)
    assert heights.right / heights.normal == pytest.approx([0.0, -1.0, 2.0, 0.0, 0.0])
    assert heights.normal == pytest.approx([4.0, 4.0, 100.0, 4.0, 4.0]), "a part does not stand below the board"
    assert not heights.entries.any()
    assert height_changes(tied, heights, np.ones(SIZE)) == pytest.approx([0.0, -1.0, 2.0, 0.0, 0.0])


def columns_of(tied: Coupling, c: int, count: int) -> NDArray[np.int_]:
    """The columns of the entries of a component, by the definition."""
    rows = np.arange(3 * tied.row[c], 3 * tied.last[c] + 3)
    surface = np.arange(3 * ROWS + 4, AT_CAMERAS)
    cameras = np.arange(AT_CAMERAS + 3 * tied.camera[c], SIZE)
    return np.concatenate([rows, surface, cameras])[:count]


def test_elimination_gives_the_solution_of_the_whole_system() -> None:
    g = np.random.default_rng(1)
    tied = coupled([0, 0, 2, 2, 4], [0, 1, 1, 2, 3], [1, 1, 2, 3, 3], [0, 0, 1, 1, 1])
    heights = tied.equations(g.normal(0, 1, PARTS), 1.0, 1.0)
    heights.entries[:] = g.normal(0, 1, len(heights.entries))
    heights.normal[:] += 30.0
    heights.right[:] = g.normal(0, 1, PARTS)
    envelope = Envelope.of(np.full(ROWS, ROWS - 1), SIZE - 3 * ROWS)
    normal = envelope.zeros()
    add_equations(np.arange(SIZE)[None], g.normal(0, 1, (1, 60, SIZE)), g.normal(0, 1, (1, 60)), normal)
    whole = np.zeros((SIZE + PARTS, SIZE + PARTS))
    whole[:SIZE, :SIZE] = envelope.dense(normal.values)
    whole[SIZE:, SIZE:] = np.diag(heights.normal)
    for c in range(PARTS):
        own = heights.entries[tied.at[c] : tied.at[c + 1]]
        if len(own):
            whole[SIZE + c, columns_of(tied, c, len(own))] = own
    whole[:SIZE, SIZE:] = whole[SIZE:, :SIZE].T
    full = np.linalg.solve(whole, np.concatenate([normal.right, heights.right]))
    eliminate_heights(tied, heights, normal)
    delta = np.linalg.solve(envelope.dense(normal.values), normal.right)
    assert delta == pytest.approx(full[:SIZE], rel=1e-8)
    assert height_changes(tied, heights, np.asarray(delta)) == pytest.approx(full[SIZE:], rel=1e-8)


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
