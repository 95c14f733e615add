"""Drift checks of recorded runs, computed in the same way as the station checks its live runs."""

from __future__ import annotations

from vaoi_station.drift.check_run import check_run
from vaoi_station.drift.checks import RunCheck
from vaoi_station.stitching.recordings.opening import OpenedRun
from vaoi_station.stitching.work import all_tasks


def check_recording(opened: OpenedRun) -> RunCheck:
    """Stitch a recording and check its cameras. The check has the recording's directory as its run id."""
    times_s, present = opened.recording.head.motion_times_s(), opened.present
    runner = opened.runner()
    evidence = [runner.perform(task) for task in all_tasks(present, dict(enumerate(times_s)), opened.setup)]
    _, findings = runner.conclude_with_findings(times_s, present, evidence)
    board_type = opened.setup.board_type
    return check_run(
        str(opened.recording.directory),
        "",
        "" if board_type is None else board_type.filmed_digest(),
        findings,
    )
