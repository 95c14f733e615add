"""Where a worker does its jobs: a read-only ring, and a task runner per run."""

from __future__ import annotations

import io
import logging
import os
import time
from collections.abc import Callable
from dataclasses import dataclass, field
from pathlib import Path
from typing import Any, TypeVar

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.acquisition.ring.ring import Ring
from vaoi_station.drift.check_run import check_run
from vaoi_station.errors import InternalError, VaoiError
from vaoi_station.files import Recording, open_recording
from vaoi_station.files.images import encode_jpeg, encode_png, encode_tiff
from vaoi_station.files.results import stitch_text, without_components
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
from vaoi_station.stitching.work import TaskRunner

T = TypeVar("T")

_log = logging.getLogger(__name__)


@dataclass
class _OpenedRun:
    runner: TaskRunner
    slots: dict[FrameKey, int] = field(default_factory=dict)
    evidence: dict[Task, Evidence] = field(default_factory=dict)
    """What was found here, and what was gathered from other workers."""


class WorkerRuntime:
    """One worker's tools; single-threaded, for the other cores have workers of their own."""

    def __init__(self, ring_path: str) -> None:
        cv2.setNumThreads(1)
        self._ring = Ring.attach(Path(ring_path))
        self._runs: dict[str, _OpenedRun] = {}
        self._reference: Recording | None = None

    def __enter__(self) -> WorkerRuntime:
        return self

    def __exit__(self, *_: object) -> None:
        self._runs.clear()
        self._ring.close()

    def hello(self) -> WorkerReady:
        """The sign of being ready."""
        return WorkerReady(os.getpid())

    def take(self, message: OpenRun | CloseRun | Ping | Job) -> Reply | WorkerReady | None:
        """Carry out one message; jobs have an answer."""
        if isinstance(message, Ping):
            return self.hello()
        if isinstance(message, OpenRun):
            self._open(message)
            return None
        if isinstance(message, CloseRun):
            self._runs.pop(message.run, None)
            return None
        began_s = time.monotonic()
        try:
            value, error = self._perform(message), None
        except VaoiError as refusal:
            value, error = None, refusal
        except Exception as fault:  # noqa: BLE001  a fault in one job must not take the worker's other runs with it
            _log.exception("%s failed", message)
            value, error = None, InternalError(f"{message} failed: {type(fault).__name__}: {fault}.")
        return Reply(value, error, time.monotonic() - began_s)

    def _open(self, opening: OpenRun) -> None:
        slots: dict[FrameKey, int] = {}

        def frame(camera: int, row: int) -> NDArray[Any] | None:
            slot = slots.get((camera, row))
            return None if slot is None else self._ring.frame(slot)

        runner = TaskRunner(opening.setup, frame, self._reference_of(opening))
        self._runs[opening.context.run] = _OpenedRun(runner, slots)

    def _reference_of(self, opening: OpenRun) -> Callable[[int, int], NDArray[Any] | None] | None:
        """What reads the reference's frames; they are on disk, and in the page cache from the second board on."""
        if opening.reference is None:
            return None

        directory = opening.reference

        def frame(camera: int, row: int) -> NDArray[Any] | None:
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
                return check_run(
                    job.run, job.time, job.board_type, job.setup, np.array(job.times_s), job.evidence, job.stitch
                )

    def _link(self, job: LinkJob) -> tuple[Linked, ...]:
        opened = self._runs[job.run]
        opened.slots.update(job.slots)
        found = self._guarded(
            job.context.bay, job.context.generation, lambda: [_timed(opened.runner, task) for task in job.tasks]
        )
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
        evidence = [found for task, found in opened.evidence.items() if task not in job.excluded]
        stitch = self._guarded(
            job.context.bay,
            job.context.generation,
            lambda: opened.runner.conclude(job.head.row_times_s(), tuple(job.slots), evidence),
        )
        return Concluded(without_components(stitch), stitch_text(stitch))

    def _render(self, job: RenderJob) -> bytes:
        frame = self._ring.frame(job.slot)
        crop = self._guarded(job.bay, job.generation, lambda: render(job.view, frame))
        return encoded(crop, job.format)

    def _guarded(self, bay: int, generation: int, look: Callable[[], T]) -> T:
        """What `look` saw is this run's: the bay's generation is checked before and after."""
        self._ring.check_generation(bay, generation)
        seen = look()
        self._ring.check_generation(bay, generation)
        return seen


def _timed(runner: TaskRunner, task: Task) -> tuple[Evidence, float]:
    began_s = time.monotonic()
    return runner.perform(task), time.monotonic() - began_s


def encoded(image: NDArray[Any], format: ImageFormat) -> bytes:
    """A picture as the bytes of a file."""
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
