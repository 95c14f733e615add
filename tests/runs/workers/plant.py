"""A worker pool over a ring with one textured run, for the tests of the pool."""

from __future__ import annotations

import json
import threading
from collections.abc import Callable
from pathlib import Path
from typing import Any

import numpy as np

from tests.rendering.computed import compute_views
from tests.runs.conftest import a_board_type, a_calibration, a_config
from vaoi_station.acquisition.ring import Ring, RingLayout, ring_path
from vaoi_station.runs.workers.jobs import ConcludeJob, Job, LinkJob, OpenRun, Reply, RunContext
from vaoi_station.runs.workers.picture_jobs import RenderJob
from vaoi_station.runs.workers.pool import WorkerPool
from vaoi_station.stitching.matching.evidence import Task
from vaoi_station.stitching.work import StitchSetup

PATIENCE_S = 120.0


class Plant:
    """A ring with one textured run, and a pool over it."""

    def __init__(self, directory: Path) -> None:
        config = a_config(directory)
        self.ring = Ring.create(ring_path(config), RingLayout.of(config))
        self.cameras = a_calibration().cameras(config.heads)
        line = config.line
        self.setup = StitchSetup(self.cameras, line.conveyor_mm_s, line.trigger_period_s, a_board_type())
        picture = np.random.default_rng(1).integers(0, 255, self.ring.frame(0).shape, dtype=np.uint8)
        for camera in range(2):
            for row in range(3):
                self.ring.frame(self.ring.slot(0, camera, row))[:] = picture
        self.start()

    def start(self) -> None:
        """Start the pool over the ring, and open the run."""
        self.lost: list[str] = []
        self.complete = 0
        """How often the pool has reported that all workers are ready."""
        self.news = threading.Condition()
        self.waited = 0.0
        self.on_reply: Callable[[Job], object] = lambda _: None
        self.pool = WorkerPool(2, self.ring.path)
        self.pool.start(self.worker_ended, self.workers_ready)
        self.open_run()

    def open_run(self) -> None:
        """Close the run of the test before, wait until its jobs have ended, and open a new one."""
        self.pool.close_run("r1")
        self.all_idle()
        self.context = self.next_context()
        self.pool.open_run(OpenRun(self.context, self.setup))
        self.on_reply = lambda _: None
        self.waited = 0.0
        self.lost.clear()
        self._restarts = [w.restarts for w in self.pool.status()]

    def next_context(self) -> RunContext:
        """Claim the bay for the run of the next test."""
        self.generation = self.ring.claim(0)
        return RunContext("r1", 0, self.generation)

    @property
    def restarts(self) -> list[int]:
        """The restarts of each worker in this test."""
        return [w.restarts - before for w, before in zip(self.pool.status(), self._restarts, strict=True)]

    def worker_ended(self, description: str) -> None:
        with self.news:
            self.lost.append(description)
            self.news.notify_all()

    def workers_ready(self) -> None:
        self.complete += 1

    def until(self, true: Callable[[], bool]) -> None:
        with self.news:
            while not true():
                assert self.news.wait(0.05) or self._patient()

    def _patient(self) -> bool:
        self.waited += 0.05
        return self.waited < PATIENCE_S

    def all_idle(self) -> None:
        self.until(lambda: all(w.doing == "idle" for w in self.pool.status()))

    def pid(self, worker: int) -> int:
        pid = self.pool.status()[worker].pid
        assert pid is not None
        return pid

    def link(self, camera: int = 0, row: int = 0) -> LinkJob:
        a, b = (camera, row), (camera, row + 1)
        slots = {a: self.ring.slot(0, *a), b: self.ring.slot(0, *b)}
        return LinkJob(self.context, camera, (Task("rows", a, b, 0.1),), slots)

    def picture(self, make_stitch: Callable[..., Any], head: Any) -> RenderJob:
        board_type = self.setup.board_type
        assert board_type is not None
        view = compute_views(board_type.components[0], board_type, make_stitch(head), self.cameras)[0]
        slot = self.ring.slot(0, view.camera, view.row)
        return RenderJob("r1", 0, self.generation, slot, view, "png")

    def submit(self, job: Job) -> Pending:
        pending = Pending()

        def done(reply: Reply) -> None:
            self.on_reply(job)
            pending.take(reply)

        self.pool.submit(job, done)
        return pending

    def close(self) -> None:
        self.pool.stop()
        self.ring.close()


class BoardPlant(Plant):
    """A pool over the film of a simulated board, whose result is not failed and is therefore checked."""

    def __init__(self, ring: Ring, context: RunContext, setup: StitchSetup) -> None:
        self.ring, self.cameras, self.setup = ring, setup.cameras, setup
        self._board = context
        self.start()

    def next_context(self) -> RunContext:
        """Return the context of the film, which stays in its bay."""
        return self._board

    def link_all(self, jobs: list[LinkJob]) -> None:
        """Perform link jobs."""
        assert all(answer.get().error is None for answer in [self.submit(job) for job in jobs])

    def close(self) -> None:
        self.pool.stop()


class Pending:
    """A reply that is awaited."""

    def __init__(self) -> None:
        self._there = threading.Event()
        self.answers: list[Reply] = []

    def take(self, answer: Reply) -> None:
        self.answers.append(answer)
        self._there.set()

    def get(self) -> Reply:
        assert self._there.wait(PATIENCE_S)
        return self.answers[0]


def conclusion(plant: Plant, head: Any, jobs: list[LinkJob]) -> ConcludeJob:
    slots = {(camera, row): plant.ring.slot(0, camera, row) for camera in range(2) for row in range(3)}
    return ConcludeJob(plant.context, head, slots, tuple(task for job in jobs for task in job.tasks))


def numbers(answer: Reply) -> Any:
    """The result without the time it took."""
    assert answer.error is None, answer.error
    document = json.loads(answer.value.document)
    del document["quality"]["timings_ms"]
    return document
