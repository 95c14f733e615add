"""A finished run with frames of two exposures, and a stand-in for the workers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from tests.runs.finished import held_run
from vaoi_station.errors import GoneError
from vaoi_station.geometry import Camera
from vaoi_station.model import BoardType, FrameRecord, RecordingHead, Stitch, Verdict
from vaoi_station.photometry import FlatFields
from vaoi_station.photometry.flat_fields import FlatFieldDocument, write_flat_fields
from vaoi_station.runs.merging.merged_pictures import MergedAccess
from vaoi_station.runs.workers.jobs import PictureJob
from vaoi_station.runs.workers.picture_jobs import MergeJob, RowLevelsJob

EXPOSURES_US = (200.0, 20.0)
RADIANCE = 0.5


class Merging:
    """A run whose cameras alternate between two exposures of an even surface; one frame is incomplete."""

    def __init__(
        self,
        board_type: BoardType,
        stitch: Stitch,
        cameras: tuple[Camera, ...],
        flat_fields: Path | None = None,
        flicker: float = 0.0,
        metal: float = 1.0,
    ) -> None:
        """Make the run; the brightness of its rows deviates by at most `flicker`.

        Under the light "left" the surface is `metal` times as bright as under "even".
        """
        rows = len(stitch.row_motion)
        self.levels = (1 + flicker * np.cos(2.1 * np.arange(rows))) * np.where(np.arange(rows) % 2, metal, 1.0)
        records, self.pixels, self.jobs = [], {}, list[MergeJob]()
        self.compared: list[RowLevelsJob] = []
        for i, camera in enumerate(cameras):
            for j in range(rows):
                slot = i * rows + j
                exposure_us = EXPOSURES_US[i % 2]
                verdict = Verdict.INCOMPLETE if (i, j) == (0, 1) else Verdict.OK
                light = "left" if j % 2 else "even"
                record = FrameRecord(
                    camera=i, row=j, verdict=verdict, slot=slot, exposure_us=exposure_us, gain=1.0, light=light
                )
                records.append(record)
                grey = np.full((camera.height_px, camera.width_px), RADIANCE * exposure_us * self.levels[j])
                self.pixels[slot] = np.round(grey).astype(np.uint8)
        self.gone = False
        self.recorded_in: Path | None = None
        """Folder with the frames of a recording, each named after its slot; None: there is no recording."""
        heads = [{"width": c.width_px, "height": c.height_px, "exposure_us": 100.0} for c in cameras]
        head = {"format": "vaoi-recording", "version": 1, "cameras": heads, "rows": rows}
        self.finished: Any = held_run(
            detail=SimpleNamespace(id="r1", frames=tuple(records)),
            board_type=board_type,
            cameras=cameras,
            stitch=stitch,
            head=RecordingHead.model_validate(head | {"trigger_period_s": 0.1, "conveyor_mm_s": (0.0, 100.0)}),
        )
        self.heights: dict[str, tuple[float, float]] | None = None
        """Measured heights of components and their standard deviations, mm."""
        runs = (lambda _: self.finished, lambda _: self.finished)
        self.access = MergedAccess(
            *runs, self._lease, self._recorded, self._render, flat_fields, lambda _: self.heights
        )

    @contextmanager
    def _lease(self, run: str, purpose: str) -> Iterator[Any]:
        if self.gone:
            raise GoneError(f"The frames of run {run} are gone.")
        yield SimpleNamespace(number=1, generation=7)

    def _recorded(self, run: str, camera: int, row: int) -> Path | None:
        slot = camera * len(self.levels) + row
        return None if self.recorded_in is None else self.recorded_in / f"{slot}.png"

    def _render(self, job: PictureJob, name: str) -> Any:
        if isinstance(job, RowLevelsJob):
            self.compared.append(job)
            return job.perform(self.pixels.__getitem__)
        assert isinstance(job, MergeJob)
        self.jobs.append(job)
        return job.perform(self.pixels.__getitem__)


def even_fields(directory: Path, cameras: tuple[Camera, ...]) -> Path:
    """Write flat fields without any shade, under both lights; return their directory."""
    lights: tuple[str | None, ...] = ("even", "left")
    sizes = [(c.width_px, c.height_px) for c in cameras]
    document = {
        "format": "vaoi-flatfield",
        "version": 1,
        "cameras": [{"width": w, "height": h, "read": 1.0, "shot": 0.02} for w, h in sizes],
        "fields": [
            {"camera": i, "light": light, "file": f"fields/{i}-{light}.tiff", "level": 1.0, "rows": 4}
            for i in range(len(sizes))
            for light in lights
        ],
    }
    flats = {(i, light): np.ones((h, w), np.float32) for i, (w, h) in enumerate(sizes) for light in lights}
    write_flat_fields(directory, FlatFields(FlatFieldDocument.model_validate(document), flats))
    return directory
