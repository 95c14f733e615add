"""Mosaics, heights, parts, batches and merged pictures of a held station: the real ones, made by the caller."""

from __future__ import annotations

import pickle
import shutil
import tempfile
import weakref
from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np
from numpy.typing import NDArray

from tests.runs.finished import held_run
from tests.runs.merging.finished_board import Merging
from vaoi_station.errors import GoneError, NotFoundError
from vaoi_station.files.images import encode_jpeg
from vaoi_station.hdr.encoding import MergedFormat
from vaoi_station.model import RecordingHead
from vaoi_station.mosaic import MosaicGrid
from vaoi_station.runs.archive.measured_heights import MeasuredHeights
from vaoi_station.runs.archive.measured_parts import MeasuredParts
from vaoi_station.runs.batches.batches import BatchAccess
from vaoi_station.runs.merging.merged_pictures import MergedChoice, MergeRequest
from vaoi_station.runs.mosaics.mosaics import Mosaics
from vaoi_station.runs.mosaics.opened_mosaics import PictureName


class HeldMosaics(Mosaics):
    """The real mosaics, heights, parts and batches; archive, lease and worker are stood in for."""

    def __init__(self, station: Any) -> None:
        self._station = station
        self.jobs: list[str] = []
        heights = dict[str, str]()
        self.measures = dict[str, str]()
        """Stored documents of parts, by run."""
        store = SimpleNamespace(
            heights=heights.get, save_heights=heights.__setitem__,
            parts=self.measures.get, save_parts=self.measures.__setitem__,
        )  # fmt: skip
        archive: Any = SimpleNamespace(get=self._finished, explained=self._finished, store=store)
        super().__init__(archive, self._held, self._perform)
        station.heights = MeasuredHeights(self._archive, self._held, self._render, self._bay, station)
        recorded: Any = SimpleNamespace(get=self._recorded, store=store)
        events: Any = SimpleNamespace(add=station.publish)
        good = Path(tempfile.mkdtemp())
        weakref.finalize(self, shutil.rmtree, good, ignore_errors=True)
        station.parts = MeasuredParts(recorded, self._held, self._render, self._bay, events, good)
        station.batches = BatchAccess(
            self._timed, self._timed, self._held, lambda *_: None, self._perform, station.merged
        )

    def _bay(self, run: str) -> Any:
        with self._held(run, "look-up") as bay:
            return bay

    def _finished(self, run: str, head: Any = None) -> Any:
        detail, stitch = self._station.run(run), self._station.stitch(run)
        numbered = tuple(f.model_copy(update={"slot": n}) for n, f in enumerate(detail.frames))
        return held_run(
            detail=detail.model_copy(update={"frames": numbered}),
            board_type=self._station.types[detail.board_type],
            cameras=self._station.cameras,
            stitch=stitch,
            document=self._station.stitch_text(run),
            head=head,
        )

    def _recorded(self, run: str) -> Any:
        detail, lights = self._station.run(run), self._station.lights
        camera = {"width": 320, "height": 240, "exposure_us": 100.0}
        head = {
            "format": "vaoi-recording", "version": 1, "cameras": [camera] * detail.cameras, "rows": detail.rows,
            "trigger_period_s": 0.1, "conveyor_mm_s": (50, 0),
            "lights": [lights[j % 2] for j in range(detail.rows)] if lights else None,
        }  # fmt: skip
        return self._finished(run, RecordingHead.model_validate(head))

    def _timed(self, run: str) -> Any:
        rows = self._station.run(run).rows
        return self._finished(run, SimpleNamespace(row_times_s=lambda: 0.1 * np.arange(rows)))

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

        # As between processes.
        return pickle.loads(pickle.dumps(pickle.loads(pickle.dumps(job)).perform(frame)))


class HeldKeptMosaics:
    """The small pictures that a held station keeps: of the runs that a test names."""

    def __init__(self, station: Any) -> None:
        self._station = station
        self._pictures: dict[str, bytes] = {}

    def keep(self, run: str) -> None:
        """Make the picture of a run whose frames are still there."""
        mosaics = self._station.mosaics
        self._pictures[run] = encode_jpeg(mosaics.small(run, 10**9, mosaics._held)[0])

    def grid(self, run: str) -> MosaicGrid | None:
        return self._station.mosaics.grid(run, PictureName()) if run in self._pictures else None

    def content(self, run: str) -> bytes:
        self._station.run(run)
        if run not in self._pictures:
            raise NotFoundError(f"No picture of the whole board of run {run} is kept.", code="no-kept-mosaic")
        return self._pictures[run]


class HeldMerged:
    """Real merges of frames of an even surface, for every run that the station has filmed."""

    def __init__(self, station: Any) -> None:
        self._station = station

    def pictures(self, run: str, wanted: MergeRequest) -> tuple[MergedChoice, ...]:
        return self._of(run).access.pictures(run, wanted)

    def image(
        self, run: str, wanted: MergeRequest, k: int | None, format: MergedFormat, *, sigma: bool = False
    ) -> bytes:
        return self._of(run).access.image(run, wanted, k, format, sigma=sigma)

    def _of(self, run: str) -> Merging:
        return Merging(self._station.types["demo-board"], self._station.stitch(run), self._station.cameras)
