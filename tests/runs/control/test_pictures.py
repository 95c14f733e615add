"""Requests for pictures: each caller gets its own reply; frames are found by camera and row."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from vaoi_station.errors import DeviceError, GoneError, NotFoundError, StateError
from vaoi_station.runs.control import pictures as module
from vaoi_station.runs.control.pictures import PictureRequests, frame_record
from vaoi_station.runs.workers.jobs import RenderJob, Reply


class Workers:
    """Collects jobs until the test replies."""

    def __init__(self) -> None:
        self.jobs: list[Any] = []
        self.submitted = threading.Semaphore(0)

    def submit(self, job: Any) -> None:
        self.jobs.append(job)
        self.submitted.release()

    def open_run(self, opening: Any) -> None:
        raise AssertionError("a picture opens no run")

    def close_run(self, run: str) -> None:
        raise AssertionError("a picture closes no run")


VIEW: Any = None
JOB = RenderJob("r1", 0, 1, 2, VIEW, "png")


class Immediate(Workers):
    """Replies to every job at once."""

    def __init__(self, reply: Reply) -> None:
        super().__init__()
        self.reply = reply
        self.requests = PictureRequests(self)

    def submit(self, job: Any) -> None:
        super().submit(job)
        self.requests.complete(job, self.reply)


def test_equal_jobs_of_two_callers_get_their_own_replies() -> None:
    workers = Workers()
    requests = PictureRequests(workers)
    with ThreadPoolExecutor(2) as callers:
        waiting = [callers.submit(requests.render, JOB, "U1/0") for _ in range(2)]
        for _ in waiting:
            assert workers.submitted.acquire(timeout=20)
        for job in reversed(workers.jobs):
            requests.complete(job, Reply(b"%d" % job.request, None, 0.0))
        assert sorted(w.result(20) for w in waiting) == sorted(b"%d" % job.request for job in workers.jobs)


def test_a_refusal_of_the_worker_is_raised() -> None:
    workers = Immediate(Reply(None, GoneError("gone"), 0.0))
    with pytest.raises(GoneError, match="gone"):
        workers.requests.render(JOB, "U1/0")


def test_a_late_reply_is_ignored(monkeypatch: pytest.MonkeyPatch) -> None:
    monkeypatch.setattr(module, "RENDER_LIMIT_S", 0.01)
    workers = Workers()
    requests = PictureRequests(workers)
    with pytest.raises(DeviceError, match="No worker rendered image U1/0"):
        requests.render(JOB, "U1/0")
    requests.complete(workers.jobs[0], Reply(b"late", None, 0.0))


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
