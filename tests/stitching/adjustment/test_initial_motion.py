"""The first motion is chained by medians, and rows fall into connected groups."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.stitching.adjustment.motion import nominal_motion
from vaoi_station.stitching.adjustment.problem import Observations, to_observations
from vaoi_station.stitching.adjustment.row_motion import chain_links, connected_rows
from vaoi_station.stitching.matching.evidence import Links, Task

NOMINAL = nominal_motion(np.array([0.0, 0.1, 0.2, 0.3, 0.4]), np.array([0.0, 50.0]), np.array([0.0, 0.0]))


def links(camera: Any, steps: dict[tuple[int, int], float], wild: int = 0) -> Observations:
    """Links from row p to row q with these steps in mm along y; the first `wild` of each are wrong."""
    at = np.array([[20.0 * k, 60.0] for k in range(9)])
    found = []
    for (p, q), step in steps.items():
        b = at + (0, 10 * step)
        b[:wild] += (30, -50)
        found.append(Links(Task("rows", (0, p), (0, q)), at, b, np.tile(np.eye(2), (9, 1, 1)), np.ones(9)))
    return to_observations(found, (camera,))


def test_rows_are_chained_by_the_median_of_their_links(workshop: Any) -> None:
    seen = links(workshop.camera(), {(0, 1): 5.5, (1, 2): 4.0, (2, 3): 6.0, (3, 4): 5.0}, wild=4)
    assert chain_links(NOMINAL, seen).shift[:, 1] == pytest.approx([0, -5.5, -9.5, -15.5, -20.5])


def test_rows_without_links_follow_the_nominal_belt(workshop: Any) -> None:
    seen = links(workshop.camera(), {(0, 1): 5.5, (1, 3): 11.0})
    shift = chain_links(NOMINAL, seen).shift[:, 1]
    assert shift == pytest.approx([0, -5.5, -10.5, -16.5, -21.5])


@pytest.mark.parametrize(
    ("pairs", "groups"),
    [
        ([(0, 1), (1, 2), (2, 3), (3, 4)], [[0, 1, 2, 3, 4]]),
        ([(0, 1), (3, 4)], [[0, 1], [2], [3, 4]]),
        ([(3, 4), (1, 3), (0, 2)], [[0, 2], [1, 3, 4]]),
        ([], [[0], [1], [2], [3], [4]]),
    ],
)
def test_connected_rows_form_groups(workshop: Any, pairs: list[tuple[int, int]], groups: list[list[int]]) -> None:
    seen = links(workshop.camera(), dict.fromkeys(pairs, 5.0))
    assert [g.tolist() for g in connected_rows(seen, 5, np.ones(len(seen), dtype=bool))] == groups


def test_two_links_connect_no_rows(workshop: Any) -> None:
    """Two links always fit some motion, whether they are right or not."""
    seen = links(workshop.camera(), dict.fromkeys([(0, 1), (1, 2)], 5.0))
    used = np.ones(len(seen), dtype=bool)
    used[np.flatnonzero(seen.q == 2)[2:]] = False
    assert [g.tolist() for g in connected_rows(seen, 3, used)] == [[0, 1], [2]]
    used[np.flatnonzero(seen.q == 2)[2]] = True
    assert [g.tolist() for g in connected_rows(seen, 3, used)] == [[0, 1, 2]]
