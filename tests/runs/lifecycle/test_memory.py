"""Frames, holds and pictures: memory as callers of the coordinator meet it."""

from __future__ import annotations

import threading
import time
from typing import Any

import numpy as np
import pytest

from vaoi_station.acquisition.process import messages
from vaoi_station.errors import BusyError, NotFoundError, StateError
from vaoi_station.model import Verdict
from vaoi_station.rendering import ImageRequest
from vaoi_station.runs.workers.picture_jobs import RenderJob


def test_frames_are_copies_of_the_ring_and_holes_are_refused(rig: Any) -> None:
    grant = rig.arm()
    rig.board(grant, rows=3, verdicts={0: Verdict.MISSING, 1: Verdict.INCOMPLETE})
    rig.result_of(grant.run)
    pixels, record = rig.coordinator.frame(grant.run, 1, 2)
    assert record.verdict is Verdict.OK
    assert np.all(pixels == 10 + 20 + 2)
    pixels[:] = 0
    assert np.all(rig.coordinator.frame(grant.run, 1, 2)[0] == 32)
    with pytest.raises(NotFoundError, match="never arrived: scripted"):
        rig.coordinator.frame(grant.run, 0, 1)
    with pytest.raises(StateError, match="is incomplete: scripted"):
        rig.coordinator.frame(grant.run, 1, 1)
    assert rig.coordinator.frame(grant.run, 1, 1, allow_incomplete=True)[1].verdict is Verdict.INCOMPLETE


def full(rig: Any) -> list[str]:
    """Film until every bay is held by tester 3."""
    runs, grant = [], rig.arm()
    for k in range(3):
        rig.begin(grant)
        rig.wait_run(grant.run, lambda run: run.state == "filming", "the board")
        rig.coordinator.hold(grant.run, "tester 3", "AOI")
        rig.finish(grant, rig.row(grant, 0))
        rig.result_of(grant.run)
        runs.append(grant.run)
        if k < 2:
            grant = rig.peer.expect(messages.Grant)
    rig.until("blocked")
    return runs


def test_a_full_ring_blocks_arming_names_the_holders_and_loses_nothing(rig: Any) -> None:
    runs = full(rig)
    snapshot = rig.coordinator.snapshot()
    assert [lease.holder for lease in snapshot.ring.leases] == ["tester 3"] * 3
    assert [reason.code for reason in snapshot.reasons] == ["ring-full"]
    with pytest.raises(BusyError, match=rf"run {runs[0]} is held by tester 3 \(AOI\)"):
        rig.coordinator.arm("small", "b 9")
    rig.peer.report(messages.BoardMissed(time.monotonic(), "no memory was granted for it: all of it is in use"))
    rig.wait_for(lambda: rig.coordinator.snapshot().boards_missed == 1, "a missed board")
    missed = [e for e in rig.coordinator.events() if e.kind == "board-missed"]
    assert len(missed) == 1
    assert "held by tester 3" in missed[0].action
    assert all(rig.coordinator.frame(run, 0, 0)[0].any() for run in runs)


def test_a_run_that_is_announced_keeps_its_frames_and_the_next_board_is_refused_before_it_comes(make_rig: Any) -> None:
    """Two holds in a ring of three: every further run was announced with frames, and its frames were gone at once."""
    rig = make_rig(keep_s=3600.0)
    rig.ready()
    grant = rig.arm()
    for _ in range(2):
        rig.board(grant)
        rig.result_of(grant.run)
        rig.coordinator.hold(grant.run, "tester", "AOI")
        grant = rig.peer.expect(messages.Grant)
    assert [warning.code for warning in rig.coordinator.snapshot().warnings] == ["memory-short"]
    rig.board(grant)
    run = rig.result_of(grant.run)
    assert run.frames_available
    assert run.frames_kept_until > run.finished
    rig.until("blocked")
    snapshot = rig.coordinator.snapshot()
    assert snapshot.times_blocked == 1
    [reason] = snapshot.reasons
    assert reason.code == "ring-full"
    assert f"run {run.id} is kept for" in reason.message
    assert [e.code for e in rig.coordinator.events() if e.kind == "trouble"] == ["ring-full"]
    assert rig.coordinator.frame(run.id, 0, 0)[0].any()
    rig.coordinator.release(run.id)
    rig.peer.expect(messages.Grant)
    rig.until("armed")
    assert rig.coordinator.run(run.id).frames_kept_until is None
    assert rig.coordinator.snapshot().reasons == ()


def test_large_pictures_are_rendered_under_a_lease(rig: Any) -> None:
    wanted = ImageRequest.of({"px_per_mm": 277})
    grant = rig.arm()
    rig.board(grant)
    rig.result_of(grant.run)
    [component] = rig.coordinator.components(grant.run)
    assert component.address == "U1"
    assert component.tester_mm == (10.0, 20.0)
    views = [choice.view for choice in rig.coordinator.images(grant.run, "U1").chosen]
    assert views
    assert rig.coordinator.image(grant.run, "U1", 0, wanted, format="jpeg") == b"picture"
    [job] = [job for job in rig.workers.done if isinstance(job, RenderJob)]
    assert (job.format, job.view.camera, job.view.row) == ("jpeg", views[0].camera, views[0].row)
    with pytest.raises(NotFoundError, match=f"has {len(views)} images"):
        rig.coordinator.image(grant.run, "U1", 99)
    rig.wait_for(lambda: rig.coordinator.snapshot().ring.leases == (), "the lease to end")
    rig.workers.keep = True
    drawing = threading.Thread(target=rig.coordinator.image, args=(grant.run, "U1", 0, wanted))
    drawing.start()
    rig.wait_for(lambda: len(rig.workers.kept) == 1, "the job")
    [lease] = rig.coordinator.snapshot().ring.leases
    assert (lease.run, lease.purpose) == (grant.run, "image U1/0")
    rig.workers.perform_kept()
    drawing.join(20)
