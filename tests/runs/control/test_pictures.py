"""Pixels of a run: frames are found by camera and row, and read under a lease."""

from __future__ import annotations

from typing import Any

import pytest

from vaoi_station.errors import NotFoundError, StateError
from vaoi_station.runs.control.pictures import frame_record


def test_a_frame_that_may_still_arrive_is_refused_differently_from_one_that_cannot(rig: Any) -> None:
    grant = rig.arm()
    rig.begin(grant)
    records = rig.row(grant, 0)
    rig.wait_run(grant.run, lambda run: run.counts.ok == 2, "two frames")
    under_way = rig.coordinator.run(grant.run)
    assert frame_record(under_way, 1, 0) == records[1]
    with pytest.raises(StateError, match=r"Camera 1, row 5 of run .* has not arrived yet"):
        frame_record(under_way, 1, 5)
    for camera, row in ((2, 0), (0, -1)):
        with pytest.raises(NotFoundError, match="2 cameras"):
            frame_record(under_way, camera, row)
    rig.finish(grant, records)
    finished = rig.result_of(grant.run)
    with pytest.raises(NotFoundError, match="2 cameras and 1 rows"):
        frame_record(finished, 1, 5)


def test_a_lease_ends_with_its_use_and_unknown_runs_are_not_gone_ones(rig: Any) -> None:
    grant = rig.arm()
    rig.board(grant)
    rig.result_of(grant.run)
    frames = rig.coordinator._frames
    with frames.lease(grant.run, "a test") as bay:
        assert bay.run == grant.run
        [lease] = rig.coordinator.snapshot().ring.leases
        assert (lease.run, lease.purpose) == (grant.run, "a test")
    assert rig.coordinator.snapshot().ring.leases == ()
    with pytest.raises(NotFoundError, match="no run 'never'"):
        frames.take_lease("never", "me", "a test")
