"""What the station asks of a worker, and what it gets back; all of it frozen and picklable."""

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
    """Lower goes first: matrices before pictures, the run that is nearly done before the next one, checks last."""

    CONCLUDE = 0
    LINK = 1
    GATHER = 2
    RENDER = 3
    CHECK = 4


@dataclass(frozen=True)
class RunContext:
    """Where the frames of a run are."""

    run: str
    bay: int
    generation: int


@dataclass(frozen=True)
class LinkJob:
    """Stitching tasks on frames that are in the ring: those that one frame makes possible, so that it is prepared once.

    Its answer is one `Linked` per task, in their order.
    """

    context: RunContext
    camera: int
    """Of the frame."""
    tasks: tuple[Task, ...]
    slots: Mapping[FrameKey, int]

    priority = Priority.LINK

    @property
    def run(self) -> str:
        """The run it belongs to."""
        return self.context.run

    @property
    def affinity(self) -> int | None:
        """Neighbouring cameras go to one worker, which has prepared their frames before."""
        return self.camera

    def __str__(self) -> str:
        each = (f"{t.kind} of {t.a}" + (f" and {t.b}" if t.b else "") for t in self.tasks)
        return f"{', '.join(each)} of run {self.run}"


@dataclass(frozen=True)
class GatherJob:
    """Evidence that another worker found, for the one that will conclude the run: it is there before it is needed."""

    context: RunContext
    linked: Mapping[Task, Linked]

    priority = Priority.GATHER
    affinity: int | None = None

    @property
    def run(self) -> str:
        """The run it belongs to."""
        return self.context.run

    def __str__(self) -> str:
        return f"the gathering of evidence of run {self.run}"


@dataclass(frozen=True)
class ConcludeJob:
    """All evidence of a run to one result; frames are needed for a second look at fiducials."""

    context: RunContext
    head: RecordingHead
    slots: Mapping[FrameKey, int]
    """The good frames."""
    linked: Mapping[Task, Linked]
    """All evidence; what the worker has already need not be sent to it."""
    excluded: Set[Task] = frozenset()
    """What was looked at while filming and does not count in the end: a row was lost, a bridge took its place."""

    priority = Priority.CONCLUDE
    affinity: int | None = None

    @property
    def run(self) -> str:
        """The run it belongs to."""
        return self.context.run

    def without(self, there: Collection[Task]) -> ConcludeJob:
        """For a worker that has the evidence of some tasks."""
        return replace(self, linked={task: linked for task, linked in self.linked.items() if task not in there})

    def __str__(self) -> str:
        return f"the conclusion of run {self.run}"


@dataclass(frozen=True)
class RenderJob:
    """One temporary image, encoded."""

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
    """What a finished run tells of its cameras; needs its evidence, no frames."""

    run: str
    time: str
    board_type: str
    """Digest."""
    setup: StitchSetup
    times_s: tuple[float, ...]
    evidence: tuple[Evidence, ...]
    stitch: Stitch

    priority = Priority.CHECK
    affinity: int | None = None

    def __str__(self) -> str:
        return f"the check of the cameras by run {self.run}"


Job = LinkJob | GatherJob | ConcludeJob | RenderJob | CheckJob


@dataclass(frozen=True)
class OpenRun:
    """A run whose tasks are about to come, and what all of them need; a worker gets it once."""

    context: RunContext
    setup: StitchSetup
    reference: Path | None = None
    """Directory of the reference that `setup` names."""


@dataclass(frozen=True)
class CloseRun:
    """Nothing more of this run will be asked for; forget what was prepared."""

    run: str


@dataclass(frozen=True)
class Ping:
    """Are you there?"""


@dataclass(frozen=True)
class WorkerReady:
    """The worker is there: said once it has its ring and its libraries, and whenever it is asked."""

    pid: int


@dataclass(frozen=True)
class Linked:
    """What one task gave, packed by the worker that made it: the station hands it on and need not look at it."""

    packed: bytes
    worker_s: float
    """Time it took in the worker."""

    @classmethod
    def of(cls, evidence: Evidence, worker_s: float) -> Linked:
        """Pack it."""
        return cls(pickle.dumps(evidence, pickle.HIGHEST_PROTOCOL), worker_s)

    @property
    def evidence(self) -> Evidence:
        """Unpacked anew whenever it is asked for."""
        found: Evidence = pickle.loads(self.packed)
        return found


@dataclass(frozen=True)
class Concluded:
    """A result: its document as it is kept and served, and what the station itself needs of it."""

    without_components: Stitch
    document: str


@dataclass(frozen=True)
class Reply:
    """The outcome of a job: a value, or whose fault it is that there is none."""

    value: Any
    error: VaoiError | None
    worker_s: float
    """Time it took in the worker."""
