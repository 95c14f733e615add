"""The check of a run does not depend on the order of its evidence, nor on how many links rows have."""

from __future__ import annotations

from collections.abc import Callable
from functools import partial

import pytest

from vaoi_station.drift.check_run import check_run
from vaoi_station.drift.checks import RunCheck
from vaoi_station.drift.evidence import subsample_links
from vaoi_station.simulation import Twin
from vaoi_station.stitching.work import StitchSetup, TaskRunner, all_tasks


def test_order_and_earlier_subsampling_change_nothing(knocked_twin: Callable[..., Twin]) -> None:
    """The station subsamples before it sends the evidence to a worker; a recording does not."""
    twin = knocked_twin({"camera": 2, "about": "x", "angle_deg": 0.05})
    passage = twin.passage(0)
    head, frames = passage.head(), passage.render_all()
    setup = StitchSetup(twin.cameras, head.conveyor_mm_s, head.trigger_period_s, twin.board_type)
    times_s, present = head.row_times_s(), sorted(frames)
    runner = TaskRunner(setup, lambda i, j: frames.get((i, j)))
    evidence = [runner.perform(task) for task in all_tasks(present, dict(enumerate(times_s)), setup)]
    stitch = runner.conclude(times_s, present, evidence)
    check: Callable[..., RunCheck] = partial(check_run, "r", "t", "b", setup, times_s)
    whole = check(evidence, stitch)
    assert check(evidence[::-1], stitch) == whole
    assert check([subsample_links(e) for e in evidence], stitch) == whole
    shown = whole.cameras[2]
    assert shown.y_px**2 + shown.x_px**2 == pytest.approx(3.67**2, rel=0.1), "300 mm · 14 px/mm · 0.05°"
