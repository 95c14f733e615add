"""Messages between the station and its workers: jobs, replies and the set-up of runs. All can be pickled."""

from __future__ import annotations

import pickle
from abc import ABC, abstractmethod
from collections.abc import Callable, Collection, Mapping, Set
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from typing import Any, ClassVar

from numpy.typing import NDArray

from vaoi_station.errors import VaoiError
from vaoi_station.model import RecordingHead, Status, Stitch
from vaoi_station.rendering import View
from vaoi_station.runs.states.schemas import ImageFormat
from vaoi_station.steps import Steps, completed
from vaoi_station.stitching.matching.evidence import Evidence, FrameKey, Task
from vaoi_station.stitching.work import StitchSetup


class Priority(IntEnum):
    """Order in which waiting jobs are given to workers, lowest value first.

    Results come before pictures, single pictures before batches, and all that callers wait for before work in spare
    time: codes of boards, then overviews, then heights. Small pictures also have turns between links
    (`JobQueues.choose`).
    """

    CONCLUDE = 0
    LINK = 1
    GATHER = 2
    SMALL_RENDER = 3
    RENDER = 4
    BATCH = 5
    CHECK = 6
    IDENTITY = 7
    OVERVIEW = 8
    HEIGHTS = 9


@dataclass(frozen=True)
class RunContext:
    """A run, with the number and the generation of the bay that holds its frames."""

    run: str
    bay: int
    generation: int


@dataclass(frozen=True)
class LinkJob:
    """Perform all stitching tasks that one new frame makes possible. They are one job, so that the frame is prepared
    once.

    The reply's value is a tuple with one `Linked` per task, in the order of `tasks`.
    """

    context: RunContext
    camera: int
    """Camera of the new frame."""
    tasks: tuple[Task, ...]
    slots: Mapping[FrameKey, int]
    """Slots of the frames that the tasks read."""

    priority = Priority.LINK

    @property
    def run(self) -> str:
        """The id of the run."""
        return self.context.run

    @property
    def affinity(self) -> int | None:
        """Key by which the queues choose the worker: the camera.

        Neighbouring cameras share a worker, which holds their prepared frames.
        """
        return self.camera

    def __str__(self) -> str:
        each = (f"{t.kind} of {t.a}" + (f" and {t.b}" if t.b else "") for t in self.tasks)
        return f"{', '.join(each)} of run {self.run}"


@dataclass(frozen=True)
class GatherJob:
    """Collect the evidence that another worker found.

    The job is sent to the worker that will conclude the run, before the run is complete.
    """

    context: RunContext
    linked: Mapping[Task, Linked]

    priority = Priority.GATHER
    affinity: int | None = None

    @property
    def run(self) -> str:
        """The id of the run."""
        return self.context.run

    def __str__(self) -> str:
        return f"gathering evidence of run {self.run}"


@dataclass(frozen=True)
class ConcludeJob:
    """Compute the result of a run from its evidence, and from its frames, in which fiducials are measured again.

    The reply's value is a `Concluded`. If `check` is given, a second reply follows, whose value is a `RunCheck`.
    """

    context: RunContext
    head: RecordingHead
    slots: Mapping[FrameKey, int]
    """Slots of the complete frames."""
    linked: Mapping[Task, Linked]
    """Evidence of all tasks; the pool sends the job `without` the evidence that the worker holds already."""
    excluded: Set[Task] = frozenset()
    """Tasks that the result must not use, because frames or pulses were missing and other tasks replaced them."""
    check: CheckJob | None = None
    """The calibration check that the worker performs with the same evidence after it has sent the result; None: no
    check."""
    held: Set[Task] = frozenset()
    """Tasks whose evidence the worker holds already."""

    priority = Priority.CONCLUDE
    affinity: int | None = None

    @property
    def run(self) -> str:
        """The id of the run."""
        return self.context.run

    def without(self, there: Collection[Task]) -> ConcludeJob:
        """Return a copy of the job without the evidence of the tasks in `there`, which the worker holds already."""
        held = frozenset(self.linked).intersection(there)
        linked = {task: linked for task, linked in self.linked.items() if task not in held}
        return replace(self, linked=linked, held=held)

    def __str__(self) -> str:
        return f"the conclusion of run {self.run}"


class PictureJob:
    """A job for a caller who waits for a picture: its reply goes to this caller."""

    run: str
    bay: int
    generation: int
    request: int
    """Number of the caller's request, by which the reply is passed to this caller."""

    priority: Priority = Priority.RENDER
    affinity: int | None = None

    repeatable: ClassVar[bool] = True
    """Whether an idle worker repeats the job when it is overdue."""
    longest_s: ClassVar[float | None] = None
    """Longest time for the job; None: the limit of all jobs."""


class FramesJob(PictureJob, ABC):
    """A picture job that reads several frames of one bay, or of a recording."""

    recorded = False
    """Whether the frames are read from files, so that no bay is needed."""

    @abstractmethod
    def perform(self, frame: Callable[[int], NDArray[Any]]) -> Any:
        """Return the reply's value. `frame` returns the pixels of a slot, which may change until this returns."""


class SteppedJob(FramesJob):
    """A job of seconds in steps of milliseconds: its worker performs more urgent jobs in between (`Paused`)."""

    # Another worker would have to begin anew, and none would be left for the next board.
    repeatable: ClassVar[bool] = False

    @abstractmethod
    def steps(self, frame: Callable[[int], NDArray[Any]]) -> Steps[Any]:
        """Return the steps, which return the reply's value. `frame` is that of `perform`."""

    def perform(self, frame: Callable[[int], NDArray[Any]]) -> Any:
        """Perform all steps at once, and return the reply's value."""
        return completed(self.steps(frame))


@dataclass(frozen=True)
class Paused:
    """The value of a reply to a stepped job that is not finished; the worker goes on when it gets `Continue`."""


@dataclass(frozen=True)
class Continue:
    """Go on with a paused job. It names the job, which may be large, by its run and the number of its request."""

    run: str
    request: int


@dataclass(frozen=True)
class RenderJob(PictureJob):
    """Render one temporary image; the reply's value is the encoded file.

    `bay`, `generation` and `slot` are the place of the frame in the ring. They have no meaning if `file` is given.
    """

    run: str
    bay: int
    generation: int
    slot: int
    view: View
    format: ImageFormat
    request: int = 0
    """Number of the caller's request, by which the reply is passed to this caller."""
    file: Path | None = None
    """File of the frame in the run's recording, if its memory was given to a later board; None for a frame in the
    ring."""
    minus: RenderJob | None = None
    """The picture that is subtracted from this one (`rendering.temporary.subtract`); None for a plain picture."""
    ratio: float = 1.0
    """Factor on the grey levels of `minus`."""
    priority: Priority = Priority.RENDER
    """`SMALL_RENDER` for a picture that takes no longer than a link."""

    affinity: int | None = None

    def __str__(self) -> str:
        return f"a picture from camera {self.view.camera}, row {self.view.row} of run {self.run}"


@dataclass(frozen=True)
class CheckJob:
    """Check the calibration with the evidence of a concluded run, in the worker that holds this evidence.

    This job is never queued: it is sent as a part of the run's `ConcludeJob`. The reply's value is a `RunCheck`.
    """

    run: str
    time: str
    """Time at which the conclusion was requested (UTC); it is stored with the check."""
    board_type: str
    """Digest of the run's board type."""
    calibration: str
    """Digest of the calibration that the run was stitched with."""

    priority = Priority.CHECK
    affinity: int | None = None

    def __str__(self) -> str:
        return f"the calibration check of run {self.run}"


Job = LinkJob | GatherJob | ConcludeJob | PictureJob | CheckJob


@dataclass(frozen=True)
class OpenRun:
    """Announce a run to a worker, with the set-up that all tasks of the run need; sent once to each worker."""

    context: RunContext
    setup: StitchSetup
    reference: Path | None = None
    """Directory of the reference that `setup` uses; None if it uses no reference."""


@dataclass(frozen=True)
class CloseRun:
    """Instruct a worker to forget a run's evidence and prepared frames."""

    run: str


@dataclass(frozen=True)
class Ping:
    """Ask an idle worker to reply with `WorkerReady`, as a check of its liveness."""


@dataclass(frozen=True)
class WorkerReady:
    """Report that a worker is ready; sent at its start, and in reply to each `Ping`."""

    pid: int


@dataclass(frozen=True)
class Linked:
    """Evidence of one task, pickled by the worker that found it.

    The station passes the bytes on without unpacking them, which saves time in the coordinator's thread.
    """

    packed: bytes
    worker_s: float
    """Time that the worker took for the task."""

    @classmethod
    def of(cls, evidence: Evidence, worker_s: float) -> Linked:
        """Pickle the evidence of a task. `worker_s` is the time that the worker needed for the task."""
        return cls(pickle.dumps(evidence, pickle.HIGHEST_PROTOCOL), worker_s)

    @property
    def evidence(self) -> Evidence:
        """The unpickled evidence. Each access unpickles it again."""
        found: Evidence = pickle.loads(self.packed)
        return found


@dataclass(frozen=True)
class Concluded:
    """The result of a run: the complete JSON document, and the part without components, which the station uses."""

    without_components: Stitch
    document: str


@dataclass(frozen=True)
class Reply:
    """The outcome of a job: a value or an error."""

    value: Any
    error: VaoiError | None
    worker_s: float
    """Time that the worker took for the job."""

    @classmethod
    def refused(cls, error: VaoiError) -> Reply:
        """Return the reply to a job that no worker performed."""
        return cls(None, error, 0.0)


def check_after(job: Job, reply: Reply) -> CheckJob | None:
    """Return the calibration check that the worker performs after this reply; None if there is none.

    A failed result gives no evidence about the cameras: its board was not found, or is hardly in the picture.
    """
    if not isinstance(job, ConcludeJob) or reply.error is not None:
        return None
    return None if reply.value.without_components.status is Status.FAILED else job.check
