"""A board of the small twin whose frames lie in a ring, with its tasks and the jobs for them."""

from __future__ import annotations

from collections.abc import Iterator, Sequence
from dataclasses import dataclass
from pathlib import Path

import pytest

from tests.runs.workers.plant import BoardPlant, Plant
from vaoi_station.acquisition.ring import FrameShape, Ring, RingLayout
from vaoi_station.model import RecordingHead, Status
from vaoi_station.runs.workers.jobs import ConcludeJob, ExplainJob, LinkJob, OpenRun, RunContext, WantedCheck
from vaoi_station.simulation import Twin, read_scenario
from vaoi_station.stitching.matching.evidence import FrameKey, Task
from vaoi_station.stitching.quality.findings import Findings
from vaoi_station.stitching.work import StitchSetup, TaskRunner, all_tasks

SCENARIO = Path(__file__).parents[2] / "drift" / "three.toml"
WANTED = WantedCheck("r1", "2026-01-01T00:00:00Z", "board-type", "calibration")
CHECK = ExplainJob("r1", Status.OK, (), (), WANTED)


@dataclass(frozen=True)
class RingBoard:
    """One run in bay 0 of a ring; every frame has arrived."""

    ring: Ring
    context: RunContext
    head: RecordingHead
    setup: StitchSetup
    tasks: tuple[Task, ...]

    @property
    def slots(self) -> dict[FrameKey, int]:
        cameras, rows = len(self.setup.cameras), self.head.rows
        return {(i, j): self.ring.slot(0, i, j) for i in range(cameras) for j in range(rows)}

    @property
    def opening(self) -> OpenRun:
        return OpenRun(self.context, self.setup)

    def link(self, *tasks: Task) -> LinkJob:
        return LinkJob(self.context, tasks[0].a[0], tasks, self.slots)

    def findings(self) -> Findings:
        """Conclude the run outside a worker."""
        runner = TaskRunner(self.setup, lambda i, j: self.ring.frame(self.ring.slot(0, i, j)))
        evidence = [runner.perform(task) for task in self.tasks]
        return runner.conclude_with_findings(self.head.row_times_s(), tuple(self.slots), evidence)[1]

    def conclusion(self, tasks: Sequence[Task] | None = None) -> ConcludeJob:
        return ConcludeJob(self.context, self.head, self.slots, self.tasks if tasks is None else tuple(tasks))


@pytest.fixture(scope="session")
def ring_board(tmp_path_factory: pytest.TempPathFactory) -> Iterator[RingBoard]:
    twin = Twin(read_scenario(SCENARIO))
    passage = twin.passage(0)
    head, frames = passage.head(), passage.render_all()
    shapes = tuple(FrameShape(c.width, c.height, "Mono8") for c in head.cameras)
    ring = Ring.create(tmp_path_factory.mktemp("ring") / "ring", RingLayout(1, head.rows, shapes))
    context = RunContext("r1", 0, ring.claim(0))
    for (camera, row), pixels in frames.items():
        ring.frame(ring.slot(0, camera, row))[:] = pixels
    setup = StitchSetup(twin.cameras, head.conveyor_mm_s, head.trigger_period_s, twin.board_type)
    tasks = all_tasks(sorted(frames), dict(enumerate(head.row_times_s())), setup)
    yield RingBoard(ring, context, head, setup, tasks)
    ring.close()


@pytest.fixture(scope="module")
def shared(tmp_path_factory: pytest.TempPathFactory) -> Iterator[Plant]:
    made = Plant(tmp_path_factory.mktemp("plant"))
    yield made
    made.close()


@pytest.fixture
def plant(shared: Plant) -> Plant:
    """The shared pool with a new run."""
    shared.open_run()
    return shared


@pytest.fixture
def board_plant(ring_board: RingBoard) -> Iterator[BoardPlant]:
    """A pool over the film of a simulated board: its result is good, so that the worker checks the calibration."""
    made = BoardPlant(ring_board.ring, ring_board.context, ring_board.setup)
    yield made
    made.close()
