"""Derived findings of a run: groups of rows, seams, pairs of cameras that do not overlap."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from vaoi_station.geometry.robust import Failure
from vaoi_station.stitching.quality.findings import Findings
from vaoi_station.stitching.work import TaskRunner


def findings_of(filmed: Any, frames: dict[tuple[int, int], Any] | None = None, **setup: Any) -> Findings:
    """Return the findings of the twin's board, perhaps with other frames or another setup."""
    there = filmed.frames if frames is None else frames
    runner = TaskRunner(replace(filmed.setup, **setup), lambda i, j: there.get((i, j)))
    evidence = [runner.perform(task) for task in filmed.tasks if task.a in there and (task.b or task.a) in there]
    return runner.conclude_with_findings(filmed.times_s, sorted(there), evidence)[1]


@pytest.fixture(scope="module")
def sound(filmed: Any) -> Findings:
    return findings_of(filmed)


def test_a_sound_run_is_one_group_of_all_rows(sound: Findings, filmed: Any) -> None:
    assert [g.tolist() for g in sound.connected_groups] == [list(range(filmed.head.rows))]
    assert sound.placed == (True,) * filmed.head.rows
    assert sound.non_overlapping_pairs == {}
    assert sound.rows == filmed.head.rows


def test_the_final_solution_is_that_with_the_board(sound: Findings) -> None:
    assert sound.mapping is not None
    assert sound.adjusted is sound.mapping.adjusted
    assert sound.problem is sound.mapping.problem
    assert sound.cad_matrix is not None
    assert sound.surface is not None


def test_seams_are_numbered_by_their_left_camera(sound: Findings) -> None:
    o = sound.problem.links
    assert set(o.seam.tolist()) == {-1, 0}
    assert ((o.seam >= 0) == (o.p == o.q)).all()
    assert set(sound.seams_px) == {(0, 1)}
    assert sound.seams_px[0, 1] < 0.1


def test_without_a_board_the_solution_is_that_of_the_links(filmed: Any) -> None:
    found = findings_of(filmed, board_type=None)
    assert isinstance(found.found, Failure)
    assert found.adjusted is found.moved
    assert found.problem is found.moved.problem
    assert (found.mapping, found.cad_matrix, found.views, found.surface, found.heights) == (None, None, None, None, {})


def test_blank_rows_split_the_run_unless_cad_points_fix_both_parts(filmed: Any) -> None:
    frames = {key: np.full_like(p, 20) if key[1] in (2, 3) else p for key, p in filmed.frames.items()}
    assert [g.tolist() for g in findings_of(filmed, frames).connected_groups] == [[0, 1], [4, 5]]


def test_cameras_that_show_different_things_are_a_pair(filmed: Any) -> None:
    """Camera 1 shows the board 36 px further: what is left of the overlap does not match."""
    pushed = {key: np.roll(p, 36, 1) if key[0] == 1 else p for key, p in filmed.frames.items()}
    found = findings_of(filmed, pushed)
    assert set(found.non_overlapping_pairs) == {(0, 1)}
    assert found.non_overlapping_pairs[0, 1] >= 2


def test_heights_are_those_of_components_of_the_board_type(sound: Findings, filmed: Any) -> None:
    assert sound.heights
    assert set(sound.heights) <= {c.address for c in filmed.board_type.components}
    assert all(h.links >= 2 and h.sigma_mm > 0 for h in sound.heights.values())
