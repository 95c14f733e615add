"""The progress of one run from the barrier to its result: its frames, tasks, evidence and result.

This module does not communicate with workers. It returns the jobs that have become possible, and processes the replies.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from vaoi_station.acquisition.process.messages import FrameSettled, RunFinished, RunStarted
from vaoi_station.errors import VaoiError
from vaoi_station.model import FrameRecord, Pulse, Reason, RecordingHead, Status, Stitch, Verdict
from vaoi_station.model.recording import motion_time_s
from vaoi_station.runs.run.memory import Bay
from vaoi_station.runs.run.order import Order
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.schemas import TaskTiming
from vaoi_station.runs.states.tables import RUN, RunState, RunStep
from vaoi_station.runs.workers.jobs import CheckJob, Concluded, ConcludeJob, LinkJob, OpenRun, Reply, RunContext
from vaoi_station.stitching.matching.evidence import FrameKey, Task
from vaoi_station.stitching.work import all_tasks, possible_tasks

WHOLE = frozenset({"clear", "single"})
"""Values of `controller.RunEnded.reason` for a regular end of the pulses: the run shows everything that passed."""


@dataclass
class Progress:
    """The data of a run that is filmed or stitched. Times in s are host times by time.monotonic()."""

    order: Order
    opening: OpenRun
    barrier_s: float
    state: RunState = RUN.start
    pulses: dict[int, Pulse] = field(default_factory=dict)
    frames: dict[FrameKey, FrameRecord] = field(default_factory=dict)
    settled_s: dict[FrameKey, float] = field(default_factory=dict)
    linkable: set[FrameKey] = field(default_factory=set)
    """Complete frames whose pulse was reported, so that they can be linked."""
    requested_s: dict[Task, float] = field(default_factory=dict)
    """Tasks for which a job was made; for each task, the time at which the last of its frames was settled."""
    failed: set[Task] = field(default_factory=set)
    """Tasks that gave no evidence."""
    pending: set[Task] = field(default_factory=set)
    """Requested tasks whose reply has not arrived."""
    canonical_tasks: tuple[Task, ...] = ()
    """The tasks whose evidence the result uses; empty until all frames are settled."""
    pending_canonical: set[Task] = field(default_factory=set)
    """Canonical tasks whose reply has not arrived."""
    timings: list[TaskTiming] = field(default_factory=list)
    recorded: RunFinished | None = None
    """The final report of the acquisition process; None while filming."""
    armed_s: float = float("-inf")
    """Time since which the order of the run has been in force."""
    id_doubted: bool = False
    """Whether the order's board id may belong to another board."""
    faults: list[Reason] = field(default_factory=list)
    """Reasons why the run is degraded or failed, other than missing or incomplete frames."""
    unstitchable: bool = False
    """Whether no result is possible, because a job that is necessary for the result has failed."""
    result: Concluded | None = None
    concluding: bool = False
    """Whether the conclude job was made."""
    done: bool = False
    """Whether the run is complete and only waits until earlier runs have ended."""
    conclude_ms: float = 0.0
    ready_s: float | None = None

    @classmethod
    def begin(cls, report: RunStarted, bay: Bay, order: Order) -> Progress:
        """Begin the run of a board that has interrupted the barrier; its frames go into `bay`."""
        reference = order.reference.directory if order.reference else None
        context = RunContext(report.run, bay.number, bay.generation)
        return cls(order, OpenRun(context, order.setup, reference), report.host_time_s)

    @property
    def context(self) -> RunContext:
        """The id of the run, with the number of its bay and the generation of the bay."""
        return self.opening.context

    @property
    def run(self) -> str:
        """Id of the run."""
        return self.context.run

    @property
    def head(self) -> RecordingHead | None:
        """Head of the run's recording; None while the board is filmed."""
        return self.recorded.head if self.recorded else None

    @property
    def present(self) -> tuple[FrameKey, ...]:
        """Keys (camera, row) of the usable frames, sorted."""
        return tuple(sorted(key for key, frame in self.frames.items() if frame.usable))

    @property
    def stitch(self) -> Stitch | None:
        """The result without its tables of components; None while there is no result."""
        return self.result.without_components if self.result else None

    def advance(self, event: RunStep) -> None:
        """Change to the state that follows a step in the table `RUN`; `StateError` if the step is illegal."""
        self.state = RUN.next(self.state, event)

    def settle(self, report: FrameSettled) -> list[LinkJob]:
        """Record the verdict of a frame, and return the jobs that have become possible with this frame."""
        key = (report.frame.camera, report.frame.row)
        self.frames[key] = report.frame
        self.settled_s[key] = report.host_time_s
        if report.frame.verdict is not Verdict.OK or key[1] not in self.pulses:
            return []
        # A frame without a reported pulse has no time before the final report, so `settle` has already returned for it
        # above.
        self.linkable.add(key)
        return self._jobs_for(key[0], possible_tasks(key, self.linkable, self._times_s(), self.order.setup))

    def filmed(self, report: RunFinished) -> list[LinkJob]:
        """Record the final report of the acquisition process; return jobs for the canonical tasks still needed."""
        self.advance(RunStep.FILMED)
        self.recorded = report
        self.frames = {(f.camera, f.row): f for f in report.frames}
        self.canonical_tasks = self._select_canonical_tasks(dict(enumerate(report.head.motion_times_s().tolist())))
        missing = (task for task in self.canonical_tasks if task not in self.requested_s)
        jobs = [job for task in missing for job in self._jobs_for(task.a[0], (task,))]
        self.pending_canonical = self.pending.intersection(self.canonical_tasks)
        return jobs

    def _times_s(self) -> dict[int, float]:
        """Return the time of each row after the first reported pulse, rounded to 1 ns as in the recording's head.

        If the encoder spaces the rows, it is the time in which a belt at its nominal speed would have got there.
        """
        belt = self.order.plan.belt if self.order.plan is not None else None
        if belt is not None:
            velocity = self.order.setup.conveyor_mm_s
            return {row: motion_time_s(round(row * belt.row_mm, 6), velocity) for row in self.pulses}
        first_s = self.pulses[min(self.pulses)].time_s
        return {row: round(pulse.time_s - first_s, 9) for row, pulse in self.pulses.items()}

    def _select_canonical_tasks(self, times_s: dict[int, float]) -> tuple[Task, ...]:
        """Return the tasks whose evidence the result uses, given the final row times.

        These are the tasks requested while filming, unless a frame or a pulse is missing or a row time differs.
        """
        # If frames are missing, the requested tasks depend on the order in which frames arrived. Then the tasks are
        # selected anew from all frames, so that the run gives the same result as its recording. A frame that the proof
        # questions was linked while filming, and is not used either.
        whole = len(self.linkable) == len(self.frames) == len(self.order.setup.cameras) * len(times_s)
        if whole and len(self.present) == len(self.frames) and self._times_s() == times_s:
            return tuple(self.requested_s)
        return all_tasks(self.present, times_s, self.order.setup)

    def add_links(self, job: LinkJob, reply: Reply, at_s: float) -> None:
        """Record that the tasks of a link job are done; for an error, add a fault. The reply arrived at `at_s`."""
        self.pending.difference_update(job.tasks)
        self.pending_canonical.difference_update(job.tasks)
        if reply.error is not None:
            self.failed.update(job.tasks)
            self._add_error(reply.error)
            return
        self.timings += [self._timing(task, s, at_s) for task, s in zip(job.tasks, reply.value, strict=True)]

    def _timing(self, task: Task, worker_s: float, at_s: float) -> TaskTiming:
        return TaskTiming(
            kind=task.kind,
            camera=task.a[0],
            row=task.a[1],
            other_camera=task.b[0] if task.b else None,
            other_row=task.b[1] if task.b else None,
            ready_s=self.requested_s[task] - self.barrier_s,
            done_s=at_s - self.barrier_s,
            worker_ms=worker_s * 1e3,
        )

    def conclude_job(self) -> ConcludeJob | None:
        """Return the conclude job as soon as all evidence has arrived; it is returned once.

        Return None before that, at later calls, and if no result is possible.
        """
        if self.recorded is None or self.concluding or self.unstitchable or self.pending_canonical:
            return None
        self.concluding = True
        tasks = tuple(task for task in self.canonical_tasks if task not in self.failed)
        return ConcludeJob(self.context, self.recorded.head, self._slots(self.present), tasks)

    def check_job(self) -> CheckJob | None:
        """Return the calibration check that follows the conclusion; None if the run would give no evidence.

        A failed result gives none about the cameras: its board was not found, or is hardly in the picture.

        A single camera has no neighbour that could show its displacement. A run that was cut short shows a part of its
        board: a solution that fits this part well may fit the cameras badly, which looks like a drift.
        """
        if self.recorded is None or self.recorded.reason not in WHOLE or len(self.order.setup.cameras) < 2:
            return None
        if self.stitch is None or self.stitch.status is Status.FAILED:
            return None
        return CheckJob(self.run, utc(), self.order.filmed_digest, self.order.calibration_digest)

    def add_result(self, reply: Reply, at_s: float) -> None:
        """Add the result of a conclude job's reply to the run; for an error, a fault. It arrived at `at_s`."""
        self.conclude_ms = reply.worker_s * 1e3
        if reply.error is not None:
            self._add_error(reply.error)
            self.unstitchable = True
        else:
            self.result, self.ready_s = reply.value, at_s

    def add_fault(self, reason: Reason) -> None:
        """Add a fault to the reasons of the run, unless the same fault is present already."""
        if reason not in self.faults:
            self.faults.append(reason)

    @property
    def board_id(self) -> str | None:
        """The caller's id of the board; None if there is none, or if it may belong to another board."""
        return None if self.id_doubted else self.order.board_id

    def doubt_id(self, why: str) -> None:
        """Withhold the order's board id, and add the cause to the faults. No effect if there is no id."""
        if self.order.board_id is None or self.id_doubted:
            return
        self.id_doubted = True
        self.add_fault(
            Reason(
                code="board-id-uncertain",
                message=f"This run has no board id: {self.order.board_id!r} was armed, but {why}.",
                action="Identify the board, arm again with the id of the next board, and film this one again.",
            )
        )

    def _add_error(self, error: VaoiError) -> None:
        self.add_fault(Reason.of(error))
        # A task that fails only loses its evidence. A task whose workers died makes the run unstitchable: the
        # conclusion reads the same frames, and workers would die in it too.
        self.unstitchable = self.unstitchable or error.code == "worker-lost"

    def _jobs_for(self, camera: int, tasks: Iterable[Task]) -> list[LinkJob]:
        """Return one job for all given tasks that were not requested yet; an empty list if all were requested.

        `camera` is the camera of the new frame, by which a worker is chosen.
        """
        new = tuple(task for task in tasks if task not in self.requested_s)
        for task in new:
            self.requested_s[task] = max(self.settled_s.get(key, self.barrier_s) for key in _frames_of(task))
        self.pending.update(new)
        frames = dict.fromkeys(key for task in new for key in _frames_of(task))
        return [LinkJob(self.context, camera, new, self._slots(frames))] if new else []

    def _slots(self, keys: Iterable[FrameKey]) -> dict[FrameKey, int]:
        return {key: slot for key in keys if (slot := self.frames[key].slot) is not None}


def _frames_of(task: Task) -> list[FrameKey]:
    """Return the keys of this run's frames that a task reads.

    In a task of kind "reference", `b` is a frame of the reference, not of this run.
    """
    return [task.a] if task.b is None or task.kind == "reference" else [task.a, task.b]
