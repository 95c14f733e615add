"""Mosaics of the held station's runs: jobs are performed at once, in the caller's thread."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.api.held.batches import held_batches
from tests.runs.finished import held_run
from vaoi_station.errors import GoneError, NotFoundError
from vaoi_station.files.images import encode_jpeg
from vaoi_station.mosaic import MosaicGrid
from vaoi_station.runs.archive.measured_heights import MeasuredHeights
from vaoi_station.runs.mosaics.mosaics import Mosaics
from vaoi_station.runs.mosaics.opened_mosaics import PictureName


class HeldMosaics(Mosaics):
    """The real mosaics, with an archive, a lease and a worker that are stood in for."""

    def __init__(self, station: Any) -> None:
        self._station = station
        self.jobs: list[str] = []
        kept: dict[str, str] = {}
        store = SimpleNamespace(heights=kept.get, save_heights=kept.__setitem__)
        archive: Any = SimpleNamespace(get=self._finished, store=store)
        super().__init__(archive, self._held, self._perform)
        # Heights of components are measured, and batches cut, by the same workers.
        station.batches = held_batches(station)
        station.heights = MeasuredHeights(self._archive, self._held, self._render, self._bay, station)

    def _bay(self, run: str) -> Any:
        with self._held(run, "look-up") as bay:
            return bay

    def _finished(self, run: str) -> Any:
        detail = self._station.run(run)
        numbered = tuple(f.model_copy(update={"slot": n}) for n, f in enumerate(detail.frames))
        return held_run(
            detail=detail.model_copy(update={"frames": numbered}),
            board_type=self._station.types["demo-board"],
            cameras=self._station.cameras,
            stitch=self._station.stitch(run),
            document=self._station.stitch_text(run),
        )

    @contextmanager
    def _held(self, run: str, purpose: str) -> Iterator[Any]:
        if not self._station.run(run).frames_available:
            raise GoneError(f"The frames of run {run} are no longer in memory.", code="frames-gone")
        yield SimpleNamespace(number=0, generation=1)

    def _perform(self, job: Any, name: str) -> Any:
        self.jobs.append(name)
        frames = self._station.run(job.run).frames

        def frame(slot: int) -> NDArray[np.uint8]:
            pixels: NDArray[np.uint8] = self._station.pixels[job.run, frames[slot].camera, frames[slot].row]
            return pixels

        return job.perform(frame)


class HeldKeptMosaics:
    """The small pictures that a held station keeps: of the runs that a test names."""

    def __init__(self, station: Any) -> None:
        self._station = station
        self._pictures: dict[str, bytes] = {}

    def keep(self, run: str) -> None:
        """Make the picture of a run whose frames are still there."""
        mosaics = self._station.mosaics
        picture, _ = mosaics.small(run, 10**9, mosaics._held)
        self._pictures[run] = encode_jpeg(picture)

    def grid(self, run: str) -> MosaicGrid | None:
        found: MosaicGrid = self._station.mosaics.grid(run, PictureName())
        return found if run in self._pictures else None

    def content(self, run: str) -> bytes:
        self._station.run(run)
        if run not in self._pictures:
            raise NotFoundError(f"No picture of the whole board of run {run} is kept.", code="no-kept-mosaic")
        return self._pictures[run]
