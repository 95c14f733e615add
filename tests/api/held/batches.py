"""Batches of the held station's runs: the real ones; parts are cut at once, in the caller's thread."""

from __future__ import annotations

import pickle
from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.api.held.merged import HeldMerged
from tests.runs.finished import held_run
from vaoi_station.errors import GoneError
from vaoi_station.files.results import stitch_text
from vaoi_station.runs.batches.batch_job import BatchJob, CutPart
from vaoi_station.runs.batches.batches import BatchAccess


def held_batches(station: Any) -> BatchAccess:
    """Return batches with an archive, a lease and a worker that are stood in for."""
    return BatchAccess(_Archive(station).get, _lease(station), lambda *_: None, _perform(station), HeldMerged(station))  # type: ignore[arg-type]


ROWS = 4


class _Archive:
    def __init__(self, station: Any) -> None:
        self._station = station

    def get(self, run: str) -> Any:
        detail, stitch = self._station.run(run), self._station.stitch(run)
        board_type, cameras = self._station.types["demo-board"], self._station.cameras
        numbered = tuple(f.model_copy(update={"slot": n}) for n, f in enumerate(detail.frames))
        return held_run(
            detail=detail.model_copy(update={"frames": numbered}),
            board_type=board_type,
            cameras=cameras,
            stitch=stitch,
            document=stitch_text(stitch),
            head=SimpleNamespace(row_times_s=lambda: 0.1 * np.arange(ROWS)),
        )


def _lease(station: Any) -> Any:
    @contextmanager
    def lease(run: str, purpose: str) -> Iterator[Any]:
        if not station.run(run).frames_available:
            raise GoneError(f"The frames of run {run} are no longer in memory.", code="frames-gone")
        yield SimpleNamespace(number=0, generation=1)

    return lease


def _perform(station: Any) -> Any:
    def perform(job: BatchJob, name: str) -> CutPart:
        sent: BatchJob = pickle.loads(pickle.dumps(job))
        frames = station.run(job.run).frames

        def pixels(slot: int) -> NDArray[Any]:
            found: NDArray[Any] = station.pixels[job.run, frames[slot].camera, frames[slot].row]
            return found

        reply: CutPart = pickle.loads(pickle.dumps(sent.perform(pixels)))
        return reply

    return perform
