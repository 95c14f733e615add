"""Requests for pictures: each caller gets its own reply."""

from __future__ import annotations

import threading
from concurrent.futures import ThreadPoolExecutor
from typing import Any

import pytest

from vaoi_station.errors import DeviceError, GoneError
from vaoi_station.runs.pictures import picture_requests as module
from vaoi_station.runs.pictures.picture_requests import PictureRequests
from vaoi_station.runs.workers.jobs import RenderJob, Reply


class Workers:
    """Collects jobs until the test replies."""

    def __init__(self) -> None:
        self.jobs: list[Any] = []
        self.submitted = threading.Semaphore(0)

    def submit(self, job: Any) -> None:
        self.jobs.append(job)
        self.submitted.release()


VIEW: Any = None
JOB = RenderJob("r1", 0, 1, 2, VIEW, "png")


class Immediate(Workers):
    """Replies to every job at once."""

    def __init__(self, reply: Reply) -> None:
        super().__init__()
        self.reply = reply
        self.requests = PictureRequests(self.submit)

    def submit(self, job: Any) -> None:
        super().submit(job)
        self.requests.complete(job, self.reply)


def test_equal_jobs_of_two_callers_get_their_own_replies() -> None:
    workers = Workers()
    requests = PictureRequests(workers.submit)
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
    requests = PictureRequests(workers.submit)
    with pytest.raises(DeviceError, match="No worker rendered image U1/0"):
        requests.render(JOB, "U1/0")
    requests.complete(workers.jobs[0], Reply(b"late", None, 0.0))
