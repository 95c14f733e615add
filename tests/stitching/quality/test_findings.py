"""Derived findings of a run: groups of rows, seams, pairs of cameras that do not overlap."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import numpy as np

from vaoi_station.stitching.quality.findings import Findings
from vaoi_station.stitching.work import TaskRunner


def findings_of(filmed: Any, frames: dict[tuple[int, int], Any] | None = None, **setup: Any) -> Findings:
    """Return the findings of the twin's board, perhaps with other frames or another setup."""
    there = filmed.frames if frames is None else frames
    runner = TaskRunner(replace(filmed.setup, **setup), lambda i, j: there.get((i, j)))
    evidence = [runner.perform(task) for task in filmed.tasks if task.a in there and (task.b or task.a) in there]
    return runner.conclude_with_findings(filmed.times_s, sorted(there), evidence)[1]


def test_blank_rows_split_the_run_unless_cad_points_fix_both_parts(filmed: Any) -> None:
    frames = {key: np.full_like(p, 20) if key[1] in (2, 3) else p for key, p in filmed.frames.items()}
    assert [g.tolist() for g in findings_of(filmed, frames).connected_groups] == [[0, 1], [4, 5]]
