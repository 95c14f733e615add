"""The check of a run does not depend on the order of its evidence, and shows the camera that was knocked."""

from __future__ import annotations

from collections.abc import Callable

import pytest

from vaoi_station.drift.check_run import check_run
from vaoi_station.drift.checks import RunCheck
from vaoi_station.simulation import Twin
from vaoi_station.stitching.matching.evidence import Evidence
from vaoi_station.stitching.work import StitchSetup, TaskRunner, all_tasks


def test_the_order_of_the_evidence_changes_nothing(knocked_twin: Callable[..., Twin]) -> None:
    twin = knocked_twin({"camera": 2, "about": "x", "angle_deg": 0.05})
    passage = twin.passage(0)
    head, frames = passage.head(), passage.render_all()
    setup = StitchSetup(twin.cameras, head.conveyor_mm_s, head.trigger_period_s, twin.board_type)
    times_s, present = head.row_times_s(), sorted(frames)
    runner = TaskRunner(setup, lambda i, j: frames.get((i, j)))
    found = [runner.perform(task) for task in all_tasks(present, dict(enumerate(times_s)), setup)]

    def check(evidence: list[Evidence]) -> RunCheck:
        other = TaskRunner(setup, lambda i, j: frames.get((i, j)))
        return check_run("r", "t", "b", other.conclude_with_findings(times_s, present, evidence)[1])

    whole = check(found)
    assert check(found[::-1]) == whole
    shown = whole.cameras[2]
    assert shown.y_px**2 + shown.x_px**2 == pytest.approx(3.67**2, rel=0.1), "300 mm · 14 px/mm · 0.05°"
