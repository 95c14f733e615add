"""Where a worker does its jobs: a read-only ring, and a task runner per run."""

from __future__ import annotations

import io
import logging
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.ring.ring import Ring
from vaoi_station.drift.check_run import check_run
from vaoi_station.drift.checks import RunCheck
from vaoi_station.errors import InternalError, VaoiError
from vaoi_station.files import Recording, open_recording
from vaoi_station.files.images import encode_jpeg, encode_png, encode_tiff
from vaoi_station.files.results import stitch_text, without_components
from vaoi_station.model import Stitch
from vaoi_station.rendering import render
from vaoi_station.runs.states.schemas import ImageFormat
from vaoi_station.runs.workers.jobs import (
    CheckJob,
    CloseRun,
    Concluded,
    ConcludeJob,
    GatherJob,
    Job,
    Linked,
    LinkJob,
    OpenRun,
    Ping,
    RenderJob,
    Reply,
    WorkerReady,
)
from vaoi_station.stitching.matching.evidence import Evidence, FrameKey, Task
from vaoi_station.stitching.work import StitchSetup, TaskRunner

T = TypeVar("T")

_log = logging.getLogger(__name__)


@dataclass
class _OpenedRun:
    setup: StitchSetup
    runner: TaskRunner
    slots: dict[FrameKey, int] = field(default_factory=dict)
    evidence: dict[Task, Evidence] = field(default_factory=dict)
    """Evidence found here or gathered from other workers."""


class WorkerRuntime:
    """Everything one worker needs for its jobs; single-threaded, because each core has a worker."""

    def __init__(self, ring_path: str) -> None:
        # OpenCV would start one thread per core in every worker; k workers with k threads each slow one another down.
        cv2.setNumThreads(1)
        self._ring = Ring.attach(Path(ring_path))
        self._runs: dict[str, _OpenedRun] = {}
        self._reference: Recording | None = None

    def __enter__(self) -> WorkerRuntime:
        return self

    def __exit__(self, *_: object) -> None:
        # Runs hold views of the ring's memory, which cannot be unmapped while they exist.
        self._runs.clear()
        self._ring.close()

    def ready(self) -> WorkerReady:
        """Return the message that reports this worker as ready."""
        return WorkerReady(os.getpid())

    def replies(self, message: OpenRun | CloseRun | Ping | Job) -> Iterator[Reply | WorkerReady]:
        """Carry out one message; yield each reply as soon as it exists.

        A job has one reply; a `ConcludeJob` with a check has a second one unless it fails. The check uses the evidence
        of the conclusion, so it runs here and now, and takes the time between the two replies.
        """
        match message:
            case Ping():
                yield self.ready()
            case OpenRun():
                self._open(message)
            case CloseRun():
                self._runs.pop(message.run, None)
            case _:
                reply = _reply_of(message, lambda: self._perform(message))
                yield reply
                if isinstance(message, ConcludeJob) and reply.error is None and message.check is not None:
                    check, stitch = message.check, reply.value.without_components
                    yield _reply_of(check, lambda: self._check(check, message, stitch))

    def _open(self, opening: OpenRun) -> None:
        slots: dict[FrameKey, int] = {}

        def frame(camera: int, row: int) -> NDArray[Any] | None:
            slot = slots.get((camera, row))
            return None if slot is None else self._ring.frame(slot)

        runner = TaskRunner(opening.setup, frame, self._reference_of(opening))
        self._runs[opening.context.run] = _OpenedRun(opening.setup, runner, slots)

    def _reference_of(self, opening: OpenRun) -> Callable[[int, int], NDArray[Any] | None] | None:
        """Return a reader of the reference's frames; None without a reference."""
        if opening.reference is None:
            return None

        directory = opening.reference

        def frame(camera: int, row: int) -> NDArray[Any] | None:
            # Kept open over runs: successive boards usually share a reference, whose files are in the page cache then.
            if self._reference is None or self._reference.directory != directory:
                self._reference = open_recording(directory)
            return self._reference.frame(camera, row)

        return frame

    def _perform(self, job: Job) -> Any:
        match job:
            case LinkJob():
                return self._link(job)
            case GatherJob():
                return self._gather(job)
            case ConcludeJob():
                return self._conclude(job)
            case RenderJob():
                return self._render(job)
            case CheckJob():
                raise InternalError(f"{job} came without the conclusion it belongs to.")

    def _link(self, job: LinkJob) -> tuple[Linked, ...]:
        opened = self._runs[job.run]
        opened.slots.update(job.slots)
        found = self._guarded(
            job.context.bay, job.context.generation, lambda: [_timed(opened.runner, task) for task in job.tasks]
        )
        # Kept here as well: the worker that concludes the run need not receive its own evidence again.
        opened.evidence.update((task, evidence) for task, (evidence, _) in zip(job.tasks, found, strict=True))
        return tuple(Linked.of(evidence, worker_s) for evidence, worker_s in found)

    def _gather(self, job: GatherJob | ConcludeJob) -> None:
        opened = self._runs[job.run]
        for task, linked in job.linked.items():
            opened.evidence[task] = linked.evidence
            opened.runner.add_evidence(opened.evidence[task])

    def _conclude(self, job: ConcludeJob) -> Concluded:
        opened = self._runs[job.run]
        opened.slots.update(job.slots)
        self._gather(job)
        evidence = self._evidence(job)
        stitch = self._guarded(
            job.context.bay,
            job.context.generation,
            lambda: opened.runner.conclude(job.head.row_times_s(), tuple(job.slots), evidence),
        )
        return Concluded(without_components(stitch), stitch_text(stitch))

    def _check(self, check: CheckJob, conclusion: ConcludeJob, stitch: Stitch) -> RunCheck:
        setup, evidence = self._runs[check.run].setup, self._evidence(conclusion)
        times_s = conclusion.head.row_times_s()
        return check_run(check.run, check.time, check.board_type, setup, times_s, evidence, stitch)

    def _evidence(self, job: ConcludeJob) -> list[Evidence]:
        return [found for task, found in self._runs[job.run].evidence.items() if task not in job.excluded]

    def _render(self, job: RenderJob) -> bytes:
        frame = self._ring.frame(job.slot)
        crop = self._guarded(job.bay, job.generation, lambda: render(job.view, frame))
        return encode(crop, job.format)

    def _guarded(self, bay: int, generation: int, work: Callable[[], T]) -> T:
        """Run `work` on the frames of a bay; raise GoneError if the bay belongs to a later run, before or after.

        A frame is read without a copy or a lock. The second check refuses a result from frames that were overwritten
        meanwhile.
        """
        self._ring.check_generation(bay, generation)
        value = work()
        self._ring.check_generation(bay, generation)
        return value


def _reply_of(job: Job, work: Callable[[], Any]) -> Reply:
    """Run a job's work and time it; every fault becomes a reply with an error."""
    began_s = time.monotonic()
    try:
        value, error = work(), None
    except VaoiError as refusal:
        value, error = None, refusal
    except Exception as fault:  # noqa: BLE001  a fault in one job must not end the worker's other runs
        _log.exception("%s failed", job)
        value, error = None, InternalError(f"{job} failed: {type(fault).__name__}: {fault}.")
    return Reply(value, error, time.monotonic() - began_s)


def _timed(runner: TaskRunner, task: Task) -> tuple[Evidence, float]:
    began_s = time.monotonic()
    return runner.perform(task), time.monotonic() - began_s


def encode(image: NDArray[Any], format: ImageFormat) -> bytes:
    """Encode a picture as the bytes of a file."""
    match format:
        case "png":
            return encode_png(image)
        case "jpeg":
            return encode_jpeg(image)
        case "tiff":
            return encode_tiff(image)
        case "npy":
            file = io.BytesIO()
            np.save(file, image)
            return file.getvalue()
