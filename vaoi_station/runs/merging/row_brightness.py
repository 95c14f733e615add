"""How bright the rows of finished runs are: lamps flicker, and a worker compares the rows of a run once."""

from __future__ import annotations

import logging
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

import numpy as np

from vaoi_station.errors import GoneError, InternalError
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import FrameRecord
from vaoi_station.photometry import Taken
from vaoi_station.photometry.flat_fields import changed_ns
from vaoi_station.runs.archive.finished_runs import FinishedRun
from vaoi_station.runs.run.memory import Bay
from vaoi_station.runs.workers.jobs import PictureJob
from vaoi_station.runs.workers.picture_jobs import LevelFrame, RowLevelsJob

_log = logging.getLogger(__name__)
MOST_KEPT = 16
"""Number of runs whose levels are kept; they are one number per row."""

Lease = Callable[[str, str], AbstractContextManager[Bay]]
"""Keeps the frames of a run in memory in a `with` block; arguments are the run and the purpose."""
Render = Callable[[PictureJob, str], Any]
"""Has a worker perform a job with this name in messages, and returns the reply's value."""


class RowBrightness:
    """The levels of the rows of runs, with the flat fields of the station. Methods may be called from any thread."""

    def __init__(
        self, lease: Lease, recorded: Callable[[str, int, int], Path | None], render: Render, flat_fields: Path
    ) -> None:
        """Create it.

        Args:
            lease: keeps a run's frames in memory.
            recorded: returns the file of a frame in the run's recording; None if no recording is kept.
            render: submits a job and waits for its reply.
            flat_fields: directory of the flat fields.
        """
        self._lease, self._recorded, self._render = lease, recorded, render
        self._flat_fields = flat_fields
        self._lock = threading.Lock()
        self._kept: OrderedDict[tuple[str, int], Floats] = OrderedDict()
        self._under_way: dict[tuple[str, int], threading.Lock] = {}
        """A lock for each run whose rows are being compared."""

    def levels(self, finished: FinishedRun) -> Floats:
        """Return the level (m,) of every row of a run; 1 for all if its rows cannot be compared.

        Callers who want the same run wait for each other. Those of a run whose levels are kept do not wait.
        """
        key = finished.detail.id, changed_ns(self._flat_fields)
        with self._lock:
            if key in self._kept:
                self._kept.move_to_end(key)
                return self._kept[key]
            comparison = self._under_way.setdefault(key, threading.Lock())
        with comparison:
            with self._lock:
                if key in self._kept:
                    return self._kept[key]
            try:
                levels = self._compared(finished)
                with self._lock:
                    self._kept[key] = levels
                    while len(self._kept) > MOST_KEPT:
                        self._kept.popitem(last=False)
            except GoneError:
                # Not kept: whether the picture itself can be made is decided by its own frames.
                levels = _equal(finished)
            finally:
                with self._lock:
                    self._under_way.pop(key, None)
            return levels

    def _compared(self, finished: FinishedRun) -> Floats:
        """Return the levels of a run. Raise GoneError if none of its frames is available."""
        run, name = finished.detail.id, "brightness of the rows"
        frames = level_frames(finished.detail.frames)
        try:
            with self._lease(run, name) as bay:
                return self._performed(finished, self._job(finished, frames, bay.number, bay.generation), name)
        except GoneError:
            files = [(f, self._file(run, f)) for f in frames]
            kept = tuple(f._replace(file=file) for f, file in files if file is not None)
            if not kept:
                raise
        return self._performed(finished, self._job(finished, kept, recorded=True), name)

    def _file(self, run: str, frame: LevelFrame) -> Path | None:
        """Return the file of a recorded frame; None if it was not recorded: the others are compared without it."""
        try:
            return self._recorded(run, frame.camera, frame.row)
        except GoneError:
            return None

    def _performed(self, finished: FinishedRun, job: RowLevelsJob, name: str) -> Floats:
        try:
            levels: Floats = self._render(job, name)
        except InternalError as error:
            # Kept as well: the same comparison would end the next worker too.
            _log.warning("%s: rows count as equally bright (%s)", job, error.message)
            return _equal(finished)
        return levels

    def _job(
        self,
        finished: FinishedRun,
        frames: tuple[LevelFrame, ...],
        bay: int = 0,
        generation: int = 0,
        *,
        recorded: bool = False,
    ) -> RowLevelsJob:
        return RowLevelsJob(
            finished.detail.id,
            bay,
            generation,
            frames,
            finished.board_type,
            finished.stitch or finished.result,
            finished.cameras,
            self._flat_fields,
            recorded,
        )


def _equal(finished: FinishedRun) -> Floats:
    return np.ones(len((finished.stitch or finished.result).row_motion))


def level_frames(records: Iterable[FrameRecord]) -> tuple[LevelFrame, ...]:
    """Return the usable frames of which it is known what they were taken with."""
    return tuple(
        LevelFrame(f.camera, f.row, Taken(f.exposure_us, f.gain or 1.0, f.light or None), f.slot)
        for f in records
        if f.usable and f.slot is not None and f.exposure_us is not None
    )
