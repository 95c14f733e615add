"""One run from the barrier to its result: what has arrived, what is being worked on, what is there.

Knows nothing of processes: it says which tasks have become possible and takes their answers.
"""

from __future__ import annotations

from collections.abc import Iterable
from dataclasses import dataclass, field

from vaoi_station.acquisition.process.messages import FrameSettled, RunFinished, RunStarted
from vaoi_station.errors import VaoiError
from vaoi_station.model import FrameRecord, Pulse, RecordingHead, Stitch, Verdict
from vaoi_station.runs.run.memory import Bay
from vaoi_station.runs.run.order import Order
from vaoi_station.runs.states.schemas import Reason, TaskTiming
from vaoi_station.runs.states.tables import RUN, RunState, RunStep
from vaoi_station.runs.workers.jobs import Concluded, ConcludeJob, Linked, LinkJob, OpenRun, Reply, RunContext
from vaoi_station.stitching.matching.evidence import FrameKey, Task
from vaoi_station.stitching.work import all_tasks, possible_tasks


@dataclass
class Progress:
    """A run under way; host times are time.monotonic()."""

    order: Order
    opening: OpenRun
    barrier_s: float
    state: RunState = RUN.start
    pulses: dict[int, Pulse] = field(default_factory=dict)
    frames: dict[FrameKey, FrameRecord] = field(default_factory=dict)
    settled_s: dict[FrameKey, float] = field(default_factory=dict)
    linkable: set[FrameKey] = field(default_factory=set)
    """Frames that arrived whole, of pulses that were reported."""
    asked_s: dict[Task, float] = field(default_factory=dict)
    """Tasks given to the workers, and when their last frame had settled."""
    linked: dict[Task, Linked] = field(default_factory=dict)
    """What the tasks gave."""
    unanswered: set[Task] = field(default_factory=set)
    needed: tuple[Task, ...] = ()
    """The canonical tasks, once everything has been filmed."""
    awaited: set[Task] = field(default_factory=set)
    """Those of them that are unanswered."""
    timings: list[TaskTiming] = field(default_factory=list)
    film: RunFinished | None = None
    faults: list[Reason] = field(default_factory=list)
    """What went wrong besides the frames' verdicts."""
    hopeless: bool = False
    """Something without which there is no result has failed."""
    result: Concluded | None = None
    concluding: bool = False
    done: bool = False
    """Nothing is left to do but to tell it."""
    conclude_ms: float = 0.0
    ready_s: float | None = None

    @classmethod
    def begin(cls, report: RunStarted, bay: Bay, order: Order) -> Progress:
        """A board has interrupted the barrier."""
        reference = order.reference.directory if order.reference else None
        context = RunContext(report.run, bay.number, bay.generation)
        return cls(order, OpenRun(context, order.setup, reference), report.host_time_s)

    @property
    def context(self) -> RunContext:
        """Where its frames are."""
        return self.opening.context

    @property
    def run(self) -> str:
        """Its id."""
        return self.context.run

    @property
    def head(self) -> RecordingHead | None:
        """What was filmed; None while filming."""
        return self.film.head if self.film else None

    @property
    def present(self) -> tuple[FrameKey, ...]:
        """Frames that arrived whole."""
        return tuple(sorted(key for key, frame in self.frames.items() if frame.verdict is Verdict.OK))

    @property
    def without_components(self) -> Stitch | None:
        """The without_components of the result; None while there is none."""
        return self.result.without_components if self.result else None

    def step(self, event: RunStep) -> None:
        """Follow the table."""
        self.state = RUN.next(self.state, event)

    def settle(self, report: FrameSettled) -> list[LinkJob]:
        """A frame has its verdict; the tasks it makes possible."""
        key = (report.frame.camera, report.frame.row)
        self.frames[key] = report.frame
        self.settled_s[key] = report.host_time_s
        if report.frame.verdict is not Verdict.OK or key[1] not in self.pulses:
            return []
        self.linkable.add(key)
        return self._ask(key[0], possible_tasks(key, self.linkable, self._times_s(), self.order.setup))

    def filmed(self, report: RunFinished) -> list[LinkJob]:
        """Every frame has its verdict; the canonical tasks that were not asked for yet."""
        self.step(RunStep.FILMED)
        self.film = report
        self.frames = {(f.camera, f.row): f for f in report.frames}
        self.needed = self._canonical_tasks(dict(enumerate(report.head.row_times_s().tolist())))
        unasked = (task for task in self.needed if task not in self.asked_s)
        jobs = [job for task in unasked for job in self._ask(task.a[0], (task,))]
        self.awaited = self.unanswered.intersection(self.needed)
        return jobs

    def _times_s(self) -> dict[int, float]:
        """Of the pulses so far, after the first that was reported, to a nanosecond: as the film's head has them."""
        first_s = self.pulses[min(self.pulses)].time_s
        return {row: round(pulse.time_s - first_s, 9) for row, pulse in self.pulses.items()}

    def _canonical_tasks(self, times_s: dict[int, float]) -> tuple[Task, ...]:
        """All tasks of the run: those asked for while filming, unless something was lost on the way."""
        whole = len(self.linkable) == len(self.frames) == len(self.order.setup.cameras) * len(times_s)
        if whole and self._times_s() == times_s:
            return tuple(self.asked_s)
        return all_tasks(self.present, times_s, self.order.setup)

    def answered(self, job: LinkJob, answer: Reply, now_s: float) -> None:
        """Tasks are done, or cannot be done."""
        self.unanswered.difference_update(job.tasks)
        self.awaited.difference_update(job.tasks)
        if answer.error is not None:
            self._blame(answer.error)
            return
        for task, linked in zip(job.tasks, answer.value, strict=True):
            self.linked[task] = linked
            self.timings.append(self._timing(task, linked, now_s))

    def _timing(self, task: Task, linked: Linked, now_s: float) -> TaskTiming:
        return TaskTiming(
            kind=task.kind,
            camera=task.a[0],
            row=task.a[1],
            other_camera=task.b[0] if task.b else None,
            other_row=task.b[1] if task.b else None,
            ready_s=self.asked_s[task] - self.barrier_s,
            done_s=now_s - self.barrier_s,
            worker_ms=linked.worker_s * 1e3,
        )

    def conclusion(self) -> ConcludeJob | None:
        """The last job, once all evidence is there; None before, and if there can be none."""
        if self.film is None or self.concluding or self.hopeless or self.awaited:
            return None
        self.concluding = True
        excluded = frozenset(self.asked_s).difference(self.needed)  # those still under way, too
        return ConcludeJob(self.context, self.film.head, self._slots(self.present), self.canonical, excluded)

    @property
    def canonical(self) -> dict[Task, Linked]:
        """What the canonical tasks gave."""
        return {task: self.linked[task] for task in self.needed if task in self.linked}

    def concluded(self, answer: Reply, now_s: float) -> None:
        """The result is there, or cannot be had."""
        self.conclude_ms = answer.worker_s * 1e3
        if answer.error is not None:
            self._blame(answer.error)
            self.hopeless = True
        else:
            self.result, self.ready_s = answer.value, now_s

    def blame(self, reason: Reason) -> None:
        """Something besides the frames went wrong; it is told with the result."""
        if reason not in self.faults:
            self.faults.append(reason)

    def _blame(self, error: VaoiError) -> None:
        self.blame(Reason.of(error))
        self.hopeless = self.hopeless or error.code == "worker-lost"

    def _ask(self, camera: int, tasks: Iterable[Task]) -> list[LinkJob]:
        """One job for those tasks that were not asked for yet; none if there are none."""
        new = tuple(task for task in tasks if task not in self.asked_s)
        for task in new:
            self.asked_s[task] = max(self.settled_s.get(key, self.barrier_s) for key in _frames_of(task))
        self.unanswered.update(new)
        frames = dict.fromkeys(key for task in new for key in _frames_of(task))
        return [LinkJob(self.context, camera, new, self._slots(frames))] if new else []

    def _slots(self, keys: Iterable[FrameKey]) -> dict[FrameKey, int]:
        return {key: slot for key in keys if (slot := self.frames[key].slot) is not None}


def _frames_of(task: Task) -> list[FrameKey]:
    """The frames of the run that a task looks at; a reference's frame is none of them."""
    return [task.a] if task.b is None or task.kind == "reference" else [task.a, task.b]
