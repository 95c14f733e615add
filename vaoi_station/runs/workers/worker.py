"""A worker process: it performs jobs on frames of the ring until the station closes its pipe.

The owner of a run holds all its evidence: what it finds itself, and what the others write to their logs. If an owner
dies, another worker reads the logs, and performs the tasks whose evidence is not there.
"""

from __future__ import annotations

import gc
import logging
import mmap
import os
import time
from collections import OrderedDict
from collections.abc import Callable
from dataclasses import dataclass, field
from multiprocessing.connection import Connection
from pathlib import Path
from typing import Any, TypeVar

import cv2
from numpy.typing import NDArray

from vaoi_station.acquisition.ring import Ring
from vaoi_station.drift.check_run import check_run
from vaoi_station.drift.checks import RunCheck
from vaoi_station.drift.lamps import measure_lamps
from vaoi_station.errors import GoneError, InternalError, VaoiError
from vaoi_station.files import Recording, open_recording
from vaoi_station.files.results import stitch_text, without_components
from vaoi_station.model import RecordingHead, Stitch
from vaoi_station.runs.workers.evidence_log import EvidenceLog
from vaoi_station.runs.workers.jobs import (
    EXPLAINABLE_RUNS,
    CloseRun,
    Concluded,
    ConcludeJob,
    Explained,
    ExplainJob,
    Job,
    LinkJob,
    Numbered,
    OpenRun,
    Paused,
    PictureJob,
    Ping,
    Reply,
    RunContext,
    SteppedJob,
    WantedCheck,
    WorkerReady,
)
from vaoi_station.steps import Steps
from vaoi_station.stitching.conclude import explained
from vaoi_station.stitching.matching.evidence import Evidence, FrameKey, Task
from vaoi_station.stitching.quality.findings import Findings
from vaoi_station.stitching.work import TaskRunner

T = TypeVar("T")
ReadFrame = Callable[[int, int], "NDArray[Any] | None"]
_log = logging.getLogger(__name__)

SLICE_S = 0.005
"""Time after which a stepped job is paused, s: about the time of a link, for which it may delay others."""
GATHER_S = 0.02
"""Time between two looks at the other workers' logs while an owner has no job, s."""


def run_worker(connection: Connection[Any, Any], ring_path: str, index: int, logs: mmap.mmap, workers: int) -> None:
    """Perform jobs until the station sends None or closes the pipe. `logs` are those of all `workers`."""
    with connection, WorkerRuntime(ring_path, index, [EvidenceLog(logs, k) for k in range(workers)]) as runtime:
        try:
            connection.send(WorkerReady(os.getpid()))
            while True:
                busy = False
                while runtime.owns_runs and not connection.poll(0.0 if busy else GATHER_S):
                    runtime.gather()
                    busy = runtime.prepare()
                if (message := connection.recv()) is None:
                    return
                if (reply := runtime.reply(message)) is not None:
                    connection.send(reply)
                # Automatic collections are off; see `run_fork_server`.
                if isinstance(message, CloseRun | Ping):
                    gc.collect()
        except (EOFError, BrokenPipeError, ConnectionResetError):
            return  # The station has ended without a message.


@dataclass
class _OpenedRun:
    opening: OpenRun
    runner: TaskRunner
    slots: dict[FrameKey, int]
    frame: ReadFrame
    evidence: dict[Task, Evidence] = field(default_factory=dict)
    """Evidence that this worker found, or has taken over from others."""

    def add(self, evidence: Evidence) -> None:
        if evidence.task not in self.evidence:
            self.evidence[evidence.task] = evidence
            self.runner.add_evidence(evidence)


class WorkerRuntime:
    """Performs the jobs of one worker. It uses a single thread, because there is one worker per core."""

    def __init__(self, ring_path: str, index: int, logs: list[EvidenceLog]) -> None:
        # OpenCV starts one thread per core in every worker by default. These threads would slow one another down.
        cv2.setNumThreads(1)
        self._ring = Ring.attach(Path(ring_path))
        self._log, self._logs = logs[index], logs
        self._runs: dict[str, _OpenedRun] = {}
        self._concluded: OrderedDict[str, tuple[_OpenedRun, Findings, Stitch, RecordingHead]] = OrderedDict()
        self._reference: Recording | None = None
        self._paused: dict[int, tuple[SteppedJob, Steps[Any]]] = {}

    def __enter__(self) -> WorkerRuntime:
        return self

    def __exit__(self, *_: object) -> None:
        # These hold arrays in the ring's memory, which cannot be unmapped while they exist.
        self._runs.clear()
        self._concluded.clear()
        self._paused.clear()
        self._ring.close()

    @property
    def owns_runs(self) -> bool:
        """Whether the evidence of other workers is needed."""
        return any(opened.opening.owned for opened in self._runs.values())

    def reply(self, message: object) -> Reply | WorkerReady | None:
        """Act on one message of the station, and return the reply; `OpenRun` and `CloseRun` have none."""
        match message:
            case Ping():
                return WorkerReady(os.getpid())
            case OpenRun():
                self._open(message)
            case CloseRun():
                self._runs.pop(message.run, None)
            case Numbered(number, None):
                stepped, steps = self._paused.pop(number)
                return _reply_to(stepped, lambda: self._step(number, stepped, steps))
            case Numbered(number, job) if job is not None:
                return _reply_to(job, lambda: self._perform(number, job))
        return None

    def _perform(self, number: int, job: Job) -> Any:
        match job:
            case LinkJob():
                return self._link(job)
            case ConcludeJob():
                return self._conclude(job)
            case ExplainJob():
                return self._explain(job)
            case SteppedJob():
                return self._step(number, job, job.steps(self._ring.frame))
            case _:
                return perform_with_frames(job, self._ring)

    def gather(self) -> None:
        """Take over what the other workers have found for the open runs."""
        for log in self._logs:
            for run, generation, found, slots in log.new_records():
                opened = self._runs.get(run)
                if opened is not None and opened.opening.context.generation == generation:
                    opened.slots.update(slots)
                    for evidence in found:
                        opened.add(evidence)

    def prepare(self) -> bool:
        """Do for some ms what the conclusion of an own run will need; return False if nothing is possible yet."""
        for opened in self._runs.values():
            if opened.opening.owned:
                try:
                    if self._guarded(opened.opening.context, opened.runner.prepare):
                        return True
                except GoneError:
                    continue  # the memory of its frames has a later run: it cannot be concluded either
                except Exception:  # noqa: BLE001  the conclusion does the same and reports what fails
                    _log.exception("preparing the conclusion of run %s failed", opened.opening.context.run)
        return False

    def _open(self, opening: OpenRun) -> None:
        if opening.context.run in self._runs:
            return
        slots: dict[FrameKey, int] = {}

        def frame(camera: int, row: int) -> NDArray[Any] | None:
            slot = slots.get((camera, row))
            return None if slot is None else self._ring.frame(slot)

        runner = TaskRunner(opening.setup, frame, self._reference_of(opening.reference))
        self._runs[opening.context.run] = _OpenedRun(opening, runner, slots, frame)

    def _reference_of(self, directory: Path | None) -> ReadFrame | None:
        if directory is None:
            return None

        def frame(camera: int, row: int) -> NDArray[Any] | None:
            # The reference stays open across runs: successive boards usually use the same reference.
            if self._reference is None or self._reference.directory != directory:
                self._reference = open_recording(directory)
            return self._reference.frame(camera, row)

        return frame

    def _step(self, number: int, job: SteppedJob, steps: Steps[Any]) -> Any:
        """Go on with a stepped job for a while; return its value, or `Paused` if it is not finished."""
        until_s, value = time.monotonic() + SLICE_S, None

        def some() -> bool:
            nonlocal value
            try:
                while time.monotonic() < until_s:
                    next(steps)
            except StopIteration as end:
                value = end.value
                return True
            return False

        if some() if job.recorded else _guarded(self._ring, job.bay, job.generation, some):
            return value
        self._paused[number] = job, steps
        return Paused()

    def _link(self, job: LinkJob) -> tuple[float, ...]:
        opened = self._runs[job.run]
        opened.slots.update(job.slots)
        times_s: list[float] = []

        def perform() -> list[Evidence]:
            found: list[Evidence] = []
            for task in job.tasks:
                began_s = time.monotonic()
                found.append(opened.runner.perform(task))
                times_s.append(time.monotonic() - began_s)
            return found

        found = self._guarded(job.context, perform)
        for evidence in found:
            opened.add(evidence)
        # Also what the owner itself finds: another worker needs it if the owner dies.
        self._log.write((job.run, job.context.generation, found, job.slots))
        if opened.opening.owned:
            self.gather()
        return tuple(times_s)

    def _conclude(self, job: ConcludeJob) -> Concluded:
        opened = self._runs[job.run]
        opened.slots.update(job.slots)
        self.gather()

        def conclude() -> tuple[Stitch, Findings]:
            for task in job.tasks:
                if task not in opened.evidence:
                    opened.evidence[task] = opened.runner.perform(task)
            evidence = [opened.evidence[task] for task in job.tasks]
            times_s = job.head.motion_times_s()
            return opened.runner.answer(times_s, tuple(job.slots), evidence, job.head.doubts)

        stitch, findings = self._guarded(job.context, conclude)
        self._concluded[job.run] = opened, findings, stitch, job.head
        if len(self._concluded) > EXPLAINABLE_RUNS:
            self._concluded.popitem(last=False)
        return Concluded(without_components(stitch), stitch_text(stitch))

    def _explain(self, job: ExplainJob) -> Explained:
        if job.run not in self._concluded and job.again is not None:
            opening, conclusion = job.again
            self._open(opening)
            try:
                self._conclude(conclusion)
            finally:
                self._runs.pop(job.run, None)
        if job.run not in self._concluded:
            raise InternalError(f"{job} is not possible: the worker that concluded the run has ended.")
        concluded = _, findings, stitch, _ = self._concluded.pop(job.run)
        verdict = {"status": job.status, "reasons": job.reasons, "reason_codes": job.reason_codes}
        # The check needs no explanation, so that it does not fail with one.
        document = _reply_to(job, lambda: stitch_text(explained(stitch, findings).model_copy(update=verdict)))
        if (wanted := job.check) is None:
            return Explained(document, None)
        return Explained(document, _reply_to(wanted, lambda: self._check(wanted, *concluded)))

    def _check(
        self, check: WantedCheck, opened: _OpenedRun, findings: Findings, stitch: Stitch, head: RecordingHead
    ) -> RunCheck:
        board_type, context = opened.opening.setup.board_type, opened.opening.context
        try:
            lamps = self._guarded(context, lambda: measure_lamps(stitch, board_type, head, opened.frame))
        except GoneError:
            lamps = ()  # the memory of the frames has a later run meanwhile
        return check_run(check.run, check.time, check.board_type, findings, lamps)

    def _guarded(self, run: RunContext, work: Callable[[], T]) -> T:
        return _guarded(self._ring, run.bay, run.generation, work)


def perform_with_frames(job: PictureJob, ring: Ring) -> Any:
    """Perform a job that reads frames; return its value. Raise GoneError if their memory has a later run."""
    if job.recorded:
        return job.perform(ring.frame)
    return _guarded(ring, job.bay, job.generation, lambda: job.perform(ring.frame))


def _guarded(ring: Ring, bay: int, generation: int, work: Callable[[], T]) -> T:
    """Call `work`, which reads frames of a bay, and return its value. Raise GoneError if the bay has a later run.

    Frames are read without a copy and without a lock. Therefore the generation of the bay is checked before and after:
    a value from frames that were overwritten meanwhile is discarded.
    """
    ring.check_generation(bay, generation)
    value = work()
    ring.check_generation(bay, generation)
    return value


def _reply_to(job: object, work: Callable[[], Any]) -> Reply:
    began_s = time.monotonic()
    try:
        value, error = work(), None
    except VaoiError as refusal:
        value, error = None, refusal
    except Exception as fault:  # noqa: BLE001  an error in one job must not end the worker, which serves other runs too
        _log.exception("%s failed", job)
        value, error = None, InternalError(f"{job} failed: {type(fault).__name__}: {fault}.")
    return Reply(value, error, time.monotonic() - began_s)
