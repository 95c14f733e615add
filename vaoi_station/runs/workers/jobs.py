"""Jobs of workers, their replies, and the messages of a run. All can be pickled.

Every job names its run, has a `priority`, and says by `str` what it is, for messages.
"""

from __future__ import annotations

from abc import ABC, abstractmethod
from collections.abc import Callable, Mapping
from dataclasses import dataclass, field
from enum import IntEnum
from pathlib import Path
from typing import Any, ClassVar

from numpy.typing import NDArray

from vaoi_station.errors import InternalError, VaoiError
from vaoi_station.model import RecordingHead, Status, Stitch
from vaoi_station.steps import Steps, completed
from vaoi_station.stitching.matching.evidence import FrameKey, Task
from vaoi_station.stitching.work import StitchSetup

ReadSlot = Callable[[int], NDArray[Any]]
"""Function that returns the pixels of a slot of the ring, which are not copied."""


class WorkerLostError(InternalError):
    """A job was given up, because two workers have ended while they performed it."""

    code = "worker-lost"


class Priority(IntEnum):
    """Order in which waiting jobs are given to workers, lowest value first.

    Results come before pictures, single pictures before batches, and all that callers wait for before work in spare
    time.
    """

    CONCLUDE = 0
    LINK = 1
    CHECK = 2
    RENDER = 3
    BATCH = 4
    IDENTITY = 5
    OVERVIEW = 6
    HEIGHTS = 7


@dataclass(frozen=True)
class RunContext:
    """A run, with the number and the generation of the bay that holds its frames."""

    run: str
    bay: int
    generation: int


@dataclass(frozen=True)
class RunJob:
    """A job that the result of an open run needs; it is dropped when the run is closed."""

    context: RunContext

    @property
    def run(self) -> str:
        """The id of the run."""
        return self.context.run


@dataclass(frozen=True)
class LinkJob(RunJob):
    """Perform all tasks that one new frame makes possible; the reply's value is the time of each task, s.

    The evidence stays with the workers (`EvidenceLog`).
    """

    camera: int
    """Camera of the new frame, by which the worker is chosen: neighbouring cameras share one."""
    tasks: tuple[Task, ...]
    slots: Mapping[FrameKey, int]
    priority: ClassVar[Priority] = Priority.LINK

    def __str__(self) -> str:
        each = (f"{t.kind} of {t.a}" + (f" and {t.b}" if t.b else "") for t in self.tasks)
        return f"{', '.join(each)} of run {self.run}"


@dataclass(frozen=True)
class ConcludeJob(RunJob):
    """Compute the result of a run from the evidence of `tasks`; the reply's value is a `Concluded`.

    The worker performs the tasks whose evidence was lost with a worker.
    """

    head: RecordingHead
    slots: Mapping[FrameKey, int]
    """Slots of the usable frames."""
    tasks: tuple[Task, ...]
    priority: ClassVar[Priority] = Priority.CONCLUDE

    def __str__(self) -> str:
        return f"the conclusion of run {self.run}"


@dataclass(frozen=True)
class WantedCheck:
    """A check of the calibration with a run, which gives a `RunCheck`."""

    run: str
    time: str
    """UTC time of the request; it is stored with the check."""
    board_type: str
    """Digest of the run's board type."""
    calibration: str
    """Digest of the calibration that the run was stitched with."""

    def __str__(self) -> str:
        return f"the calibration check of run {self.run}"


@dataclass(frozen=True)
class ExplainJob:
    """Complete the result of a run with what only explains its verdict, mostly in the worker that has concluded it.

    The reply's value is an `Explained`. The verdict is that of the run's result, as its faults have left it.
    """

    run: str
    status: Status
    reasons: tuple[str, ...]
    reason_codes: tuple[str, ...]
    check: WantedCheck | None = None
    again: tuple[OpenRun, ConcludeJob] | None = None
    """With what a worker that has not concluded the run concludes it again, while its frames are in memory."""
    priority: ClassVar[Priority] = Priority.CHECK

    def __str__(self) -> str:
        return f"the explanation of run {self.run}"


@dataclass(frozen=True)
class PictureJob(ABC):
    """A job on the frames of one bay, or of a recording, for a caller who waits for the reply."""

    run: str
    bay: int
    generation: int
    priority: Priority = field(default=Priority.RENDER, kw_only=True)
    what: ClassVar[str] = "a picture"
    """What the job makes, in messages."""
    repeatable: ClassVar[bool] = True
    """Whether an idle worker repeats the job when it is overdue."""
    longest_s: ClassVar[float | None] = None
    """Longest time for the job; None: the limit of all jobs."""
    awaited_s: ClassVar[float | None] = None
    """Longest wait for the reply, if the job is done in spare time; None: the limit of all callers."""

    def __str__(self) -> str:
        return f"{self.what} of run {self.run}"

    @property
    def recorded(self) -> bool:
        """Whether the frames are read from files, so that no bay is needed."""
        return False

    @abstractmethod
    def perform(self, frame: ReadSlot) -> Any:
        """Return the reply's value. `frame` returns the pixels of a slot, which may change until this returns."""


@dataclass(frozen=True)
class SteppedJob(PictureJob):
    """A job of seconds in steps of milliseconds: its worker performs more urgent jobs in between (`Paused`)."""

    # Another worker would have to begin anew, and none would be left for the next board.
    repeatable: ClassVar[bool] = False

    @abstractmethod
    def steps(self, frame: ReadSlot) -> Steps[Any]:
        """Return the steps, which return the reply's value. `frame` is that of `perform`."""

    def perform(self, frame: ReadSlot) -> Any:
        """Perform all steps at once, and return the reply's value."""
        return completed(self.steps(frame))


EXPLAINABLE_RUNS = 4
"""Number of concluded runs for which a worker keeps what their explanations need: mostly more than the ring holds."""
Job = LinkJob | ConcludeJob | ExplainJob | PictureJob


@dataclass(frozen=True)
class Concluded:
    """The result of a run: the JSON document, not explained yet, and its part without components for the station."""

    without_components: Stitch
    document: str


@dataclass(frozen=True)
class Reply:
    """The outcome of a job: a value or an error, and the time that the worker took."""

    value: Any
    error: VaoiError | None
    worker_s: float

    @classmethod
    def refused(cls, error: VaoiError) -> Reply:
        """Return the reply to a job that no worker performed."""
        return cls(None, error, 0.0)


@dataclass(frozen=True)
class Explained:
    """The reply with the complete JSON document of a run's result, and that to the wanted check; None: none wanted."""

    document: Reply
    check: Reply | None


@dataclass(frozen=True)
class Paused:
    """The value of a reply to a stepped job that is not finished; the worker goes on when it gets its number."""


@dataclass(frozen=True)
class Numbered:
    """A job for a worker, with its number; None: go on with the paused job of this number."""

    number: int
    job: Job | None


@dataclass(frozen=True)
class OpenRun:
    """Announce a run to a worker, with the set-up that all its tasks need; sent once to each worker."""

    context: RunContext
    setup: StitchSetup
    reference: Path | None = None
    """Directory of the reference that `setup` uses; None if it uses no reference."""
    owned: bool = False
    """Whether this worker will conclude the run: it takes over the evidence of the others at once."""


@dataclass(frozen=True)
class CloseRun:
    """Make a worker forget a run's evidence and prepared frames."""

    run: str


@dataclass(frozen=True)
class Ping:
    """Ask an idle worker to reply with `WorkerReady`, as a check of its liveness."""


@dataclass(frozen=True)
class WorkerReady:
    """Report that a worker is ready; sent at its start, and in reply to each `Ping`."""

    pid: int
