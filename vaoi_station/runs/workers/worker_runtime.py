"""Execution of jobs in a worker process, with read-only access to the ring and one task runner per run."""

from __future__ import annotations

import io
import logging
import os
import time
from collections.abc import Callable, Iterator
from dataclasses import dataclass, field
from functools import partial
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.ring import Ring
from vaoi_station.drift.check_run import check_run
from vaoi_station.drift.checks import LampCheck, RunCheck
from vaoi_station.drift.lamps import measure_lamps
from vaoi_station.errors import GoneError, InternalError, VaoiError
from vaoi_station.files import Recording, open_recording
from vaoi_station.files.images import encode_jpeg, encode_png, encode_tiff, read_kept_image
from vaoi_station.files.results import stitch_text, without_components
from vaoi_station.model import RecordingHead, Stitch
from vaoi_station.rendering import render
from vaoi_station.rendering.temporary import subtract
from vaoi_station.runs.states.schemas import ImageFormat
from vaoi_station.runs.workers.jobs import (
    CheckJob,
    CloseRun,
    Concluded,
    ConcludeJob,
    Continue,
    FramesJob,
    GatherJob,
    Job,
    Linked,
    LinkJob,
    OpenRun,
    Paused,
    Ping,
    RenderJob,
    Reply,
    RunContext,
    SteppedJob,
    WorkerReady,
    check_after,
)
from vaoi_station.runs.workers.merge_job import MergeJob, merge
from vaoi_station.steps import Steps
from vaoi_station.stitching.matching.evidence import Evidence, FrameKey, Task
from vaoi_station.stitching.quality.findings import Findings
from vaoi_station.stitching.work import StitchSetup, TaskRunner

T = TypeVar("T")

_log = logging.getLogger(__name__)

SLICE_S = 0.005
"""Time after which a stepped job is paused, s: about the time of a link, for which it may delay others."""


@dataclass
class _OpenedRun:
    context: RunContext
    setup: StitchSetup
    runner: TaskRunner
    slots: dict[FrameKey, int] = field(default_factory=dict)
    evidence: dict[Task, Evidence] = field(default_factory=dict)
    """Evidence that this worker found or received from other workers, by task."""
    concluded: tuple[Findings, Stitch, RecordingHead] | None = None
    """The conclusion, from which the calibration check is made; None before the conclusion."""


class WorkerRuntime:
    """Performs the jobs of one worker. It uses a single thread, because there is one worker per core."""

    def __init__(self, ring_path: str) -> None:
        # OpenCV starts one thread per core in every worker by default. These threads would slow one another down.
        cv2.setNumThreads(1)
        self._ring = Ring.attach(Path(ring_path))
        self._runs: dict[str, _OpenedRun] = {}
        self._reference: Recording | None = None
        self._paused: dict[tuple[str, int], tuple[SteppedJob, Steps[Any]]] = {}
        """Stepped jobs that are not finished, by run and number of the request, until the pool sends `Continue`."""

    def __enter__(self) -> WorkerRuntime:
        return self

    def __exit__(self, *_: object) -> None:
        # Runs hold arrays in the ring's memory. The memory cannot be unmapped while these arrays exist.
        self._runs.clear()
        self._paused.clear()
        self._ring.close()

    def ready(self) -> WorkerReady:
        """Return the message by which this worker reports that it is ready."""
        return WorkerReady(os.getpid())

    def replies(self, message: OpenRun | CloseRun | Ping | Continue | Job) -> Iterator[Reply | WorkerReady]:
        """Process one message of the station, and yield each reply as soon as it is available.

        `Ping`, `Continue` and each job have one reply, `OpenRun` and `CloseRun` have none. A `ConcludeJob` with a check
        may have a second reply (`check_after`): the check uses the evidence of the conclusion, so it follows directly.
        """
        match message:
            case Ping():
                yield self.ready()
            case OpenRun():
                self._open(message)
            case CloseRun():
                self._runs.pop(message.run, None)
            case Continue():
                paused = self._paused.pop((message.run, message.request))
                yield _reply_of(paused[0], partial(self._step, *paused))
            case _:
                reply = _reply_of(message, lambda: self._perform(message))
                yield reply
                if (check := check_after(message, reply)) is not None:
                    yield _reply_of(check, partial(self._check, check))

    def _open(self, opening: OpenRun) -> None:
        slots: dict[FrameKey, int] = {}

        def frame(camera: int, row: int) -> NDArray[Any] | None:
            slot = slots.get((camera, row))
            return None if slot is None else self._ring.frame(slot)

        runner = TaskRunner(opening.setup, frame, self._reference_of(opening))
        self._runs[opening.context.run] = _OpenedRun(opening.context, opening.setup, runner, slots)

    def _reference_of(self, opening: OpenRun) -> Callable[[int, int], NDArray[Any] | None] | None:
        """Return a function that reads a frame (camera, row) of the run's reference; None without a reference."""
        if opening.reference is None:
            return None

        directory = opening.reference

        def frame(camera: int, row: int) -> NDArray[Any] | None:
            # The reference stays open across runs: successive boards usually use the same reference.
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
            case FramesJob():
                return self._perform_with_frames(job)
            case CheckJob():
                raise InternalError(f"{job} came without the conclusion it belongs to.")

    def _perform_with_frames(self, job: FramesJob) -> Any:
        if isinstance(job, SteppedJob):
            return self._step(job, job.steps(self._ring.frame))
        return perform_with_frames(job, self._ring)

    def _step(self, job: SteppedJob, steps: Steps[Any]) -> Any:
        """Go on with a stepped job for a while; return its value, or `Paused` if it is not finished."""
        until_s = time.monotonic() + SLICE_S
        self._ring.check_generation(job.bay, job.generation)
        try:
            while time.monotonic() < until_s:
                next(steps)
        except StopIteration as end:
            self._ring.check_generation(job.bay, job.generation)
            return end.value
        self._paused[job.run, job.request] = job, steps
        return Paused()

    def _link(self, job: LinkJob) -> tuple[Linked, ...]:
        opened = self._runs[job.run]
        opened.slots.update(job.slots)
        found = self._guarded(
            job.context.bay, job.context.generation, lambda: [_timed(opened.runner, task) for task in job.tasks]
        )
        # The evidence is kept here too, so that it need not be sent back if this worker concludes the run.
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
        # If its transfer failed, the result would follow from less evidence, and nothing would show it.
        if lost := job.held - opened.evidence.keys():
            raise InternalError(f"{job}: the evidence of {len(lost)} tasks did not reach this worker.")
        evidence = self._evidence(job)
        stitch, findings = self._guarded(
            job.context.bay,
            job.context.generation,
            lambda: opened.runner.conclude_with_findings(
                job.head.motion_times_s(), tuple(job.slots), evidence, job.head.doubts
            ),
        )
        opened.concluded = findings, stitch, job.head
        return Concluded(without_components(stitch), stitch_text(stitch))

    def _check(self, check: CheckJob) -> RunCheck:
        opened = self._runs[check.run]
        if opened.concluded is None:
            raise InternalError(f"{check} came before the conclusion of this run.")
        findings, stitch, head = opened.concluded
        return check_run(check.run, check.time, check.board_type, findings, self._lamps(opened, stitch, head))

    def _lamps(self, opened: _OpenedRun, stitch: Stitch, head: RecordingHead) -> tuple[LampCheck, ...]:
        """Measure the brightness of the board. It is empty if the memory of the frames has a later run meanwhile."""

        def frame(camera: int, row: int) -> NDArray[Any] | None:
            slot = opened.slots.get((camera, row))
            return None if slot is None else self._ring.frame(slot)

        run = opened.context
        try:
            return self._guarded(
                run.bay, run.generation, lambda: measure_lamps(stitch, opened.setup.board_type, head, frame)
            )
        except GoneError:
            return ()

    def _evidence(self, job: ConcludeJob) -> list[Evidence]:
        return [found for task, found in self._runs[job.run].evidence.items() if task not in job.excluded]

    def _render(self, job: RenderJob) -> bytes:
        if not isinstance(job, MergeJob):
            return render_picture(job, self._ring)
        if job.file is not None:
            return merge(job, self._ring.frame)
        return self._guarded(job.bay, job.generation, lambda: merge(job, self._ring.frame))

    def _guarded(self, bay: int, generation: int, work: Callable[[], T]) -> T:
        return _guarded(self._ring, bay, generation, work)


def render_picture(job: RenderJob, ring: Ring) -> bytes:
    """Render and encode the picture of a job; raise GoneError if the memory of its frame has a later run."""
    picture = _picture(job, ring)
    if job.minus is not None:
        picture = subtract(picture, _picture(job.minus, ring), job.ratio)
    return encode(picture, job.format)


def perform_with_frames(job: FramesJob, ring: Ring) -> Any:
    """Perform a job that reads frames; return its value. Raise GoneError if their memory has a later run."""
    if job.recorded:
        return job.perform(ring.frame)
    return _guarded(ring, job.bay, job.generation, partial(job.perform, ring.frame))


def _picture(job: RenderJob, ring: Ring) -> NDArray[Any]:
    """Render the picture of a job, without the one that is subtracted."""
    if job.file is not None:
        return render(job.view, read_kept_image(job.file))
    frame = ring.frame(job.slot)
    return _guarded(ring, job.bay, job.generation, lambda: render(job.view, frame))


def _guarded(ring: Ring, bay: int, generation: int, work: Callable[[], T]) -> T:
    """Call `work`, which reads frames of a bay, and return its value. Raise GoneError if the bay has a later run.

    Frames are read without a copy and without a lock. Therefore the generation of the bay is checked before and after:
    a value from frames that were overwritten meanwhile is discarded.
    """
    ring.check_generation(bay, generation)
    value = work()
    ring.check_generation(bay, generation)
    return value


def _reply_of(job: Job, work: Callable[[], Any]) -> Reply:
    """Call the function that performs a job, and return the reply, with the time taken. Errors become replies too."""
    began_s = time.monotonic()
    try:
        value, error = work(), None
    except VaoiError as refusal:
        value, error = None, refusal
    except Exception as fault:  # noqa: BLE001  an error in one job must not end the worker, which serves other runs too
        _log.exception("%s failed", job)
        value, error = None, InternalError(f"{job} failed: {type(fault).__name__}: {fault}.")
    return Reply(value, error, time.monotonic() - began_s)


def _timed(runner: TaskRunner, task: Task) -> tuple[Evidence, float]:
    began_s = time.monotonic()
    return runner.perform(task), time.monotonic() - began_s


def encode(image: NDArray[Any], format: ImageFormat) -> bytes:
    """Encode an image, and return the content of the image file."""
    match format:
        case "png":
            return encode_png(image)
        case "jpeg":
            return encode_jpeg(image)
        case "tiff":
            return encode_tiff(image)
        case "npy":
            file = io.BytesIO()
            # OpenCV stores colours as blue, green, red.
            np.save(file, image if image.ndim == 2 else np.ascontiguousarray(image[..., ::-1]))
            return file.getvalue()
