"""Messages between the station and its workers: jobs, replies and run set-up; all frozen and picklable."""

from __future__ import annotations

import pickle
from collections.abc import Collection, Mapping, Set
from dataclasses import dataclass, replace
from enum import IntEnum
from pathlib import Path
from typing import Any

from vaoi_station.errors import VaoiError
from vaoi_station.model import RecordingHead, Stitch
from vaoi_station.rendering import View
from vaoi_station.runs.states.schemas import ImageFormat
from vaoi_station.stitching.matching.evidence import Evidence, FrameKey, Task
from vaoi_station.stitching.work import StitchSetup


class Priority(IntEnum):
    """Order in which jobs are given out, lowest first: results before pictures, an ending run before the next one."""

    CONCLUDE = 0
    LINK = 1
    GATHER = 2
    RENDER = 3
    CHECK = 4


@dataclass(frozen=True)
class RunContext:
    """A run and the bay of the ring that holds its frames."""

    run: str
    bay: int
    generation: int


@dataclass(frozen=True)
class LinkJob:
    """Stitching tasks that one new frame makes possible, in one job so that the frame is prepared once.

    The reply's value is a tuple with one `Linked` per task, in their order.
    """

    context: RunContext
    camera: int
    """Camera of the new frame."""
    tasks: tuple[Task, ...]
    slots: Mapping[FrameKey, int]

    priority = Priority.LINK

    @property
    def run(self) -> str:
        """Id of the run."""
        return self.context.run

    @property
    def affinity(self) -> int | None:
        """The camera: neighbouring cameras go to one worker, which has their frames prepared already."""
        return self.camera

    def __str__(self) -> str:
        each = (f"{t.kind} of {t.a}" + (f" and {t.b}" if t.b else "") for t in self.tasks)
        return f"{', '.join(each)} of run {self.run}"


@dataclass(frozen=True)
class GatherJob:
    """Evidence from another worker, sent ahead to the worker that will conclude the run."""

    context: RunContext
    linked: Mapping[Task, Linked]

    priority = Priority.GATHER
    affinity: int | None = None

    @property
    def run(self) -> str:
        """Id of the run."""
        return self.context.run

    def __str__(self) -> str:
        return f"gathering evidence of run {self.run}"


@dataclass(frozen=True)
class ConcludeJob:
    """Compute the result of a run from its evidence; frames are needed to measure the fiducials again.

    The reply's value is a `Concluded`. With `check`, a second reply follows, whose value is a `RunCheck`.
    """

    context: RunContext
    head: RecordingHead
    slots: Mapping[FrameKey, int]
    """Slots of the complete frames."""
    linked: Mapping[Task, Linked]
    """All evidence; see `without` for what the worker holds already."""
    excluded: Set[Task] = frozenset()
    """Tasks performed while filming that the result must not use, because a row was lost and others replace them."""
    check: CheckJob | None = None
    """The calibration check to perform with the same evidence, after the result was sent."""

    priority = Priority.CONCLUDE
    affinity: int | None = None

    @property
    def run(self) -> str:
        """Id of the run."""
        return self.context.run

    def without(self, there: Collection[Task]) -> ConcludeJob:
        """Return the job for a worker that holds the evidence of some tasks already."""
        return replace(self, linked={task: linked for task, linked in self.linked.items() if task not in there})

    def __str__(self) -> str:
        return f"the conclusion of run {self.run}"


@dataclass(frozen=True)
class RenderJob:
    """Render one temporary image; the reply's value is the encoded file."""

    run: str
    bay: int
    generation: int
    slot: int
    view: View
    format: ImageFormat
    request: int = 0
    """Number of the caller's request; it identifies the answer."""

    priority = Priority.RENDER
    affinity: int | None = None

    def __str__(self) -> str:
        return f"a picture from camera {self.view.camera}, row {self.view.row} of run {self.run}"


@dataclass(frozen=True)
class CheckJob:
    """The calibration check of a concluded run, performed by the worker that holds its evidence.

    It is never queued: it travels inside its `ConcludeJob`. The reply's value is a `RunCheck`.
    """

    run: str
    time: str
    """Time of the run's conclusion (UTC), stored with the check."""
    board_type: str
    """Digest."""
    calibration: str
    """Digest of the calibration that the run was stitched with."""

    priority = Priority.CHECK
    affinity: int | None = None

    def __str__(self) -> str:
        return f"the calibration check of run {self.run}"


Job = LinkJob | GatherJob | ConcludeJob | RenderJob | CheckJob


@dataclass(frozen=True)
class OpenRun:
    """Announce a run and the set-up that all its tasks need; sent to a worker once."""

    context: RunContext
    setup: StitchSetup
    reference: Path | None = None
    """Directory of the reference that `setup` names; None without one."""


@dataclass(frozen=True)
class CloseRun:
    """Instruct a worker to forget a run's evidence and prepared frames."""

    run: str


@dataclass(frozen=True)
class Ping:
    """Ask an idle worker for a sign of life."""


@dataclass(frozen=True)
class WorkerReady:
    """Report that the worker is ready: sent after its warm-up, and in reply to each `Ping`."""

    pid: int


@dataclass(frozen=True)
class Linked:
    """Evidence of one task, pickled by the worker that found it.

    The station passes the bytes on without unpacking them, which saves time in the coordinator's thread.
    """

    packed: bytes
    worker_s: float
    """Time the worker took."""

    @classmethod
    def of(cls, evidence: Evidence, worker_s: float) -> Linked:
        """Pack the evidence of a task."""
        return cls(pickle.dumps(evidence, pickle.HIGHEST_PROTOCOL), worker_s)

    @property
    def evidence(self) -> Evidence:
        """The evidence; each access unpacks it again."""
        found: Evidence = pickle.loads(self.packed)
        return found


@dataclass(frozen=True)
class Concluded:
    """The result of a run: its JSON document, and the part that the station itself uses."""

    without_components: Stitch
    document: str


@dataclass(frozen=True)
class Reply:
    """The outcome of a job: a value or an error."""

    value: Any
    error: VaoiError | None
    worker_s: float
    """Time the worker took."""
