"""A finished run with frames of two exposures, and a stand-in for the workers."""

from __future__ import annotations

from collections.abc import Iterator
from contextlib import contextmanager
from pathlib import Path
from types import SimpleNamespace
from typing import Any

import numpy as np

from vaoi_station.errors import GoneError
from vaoi_station.geometry import Camera
from vaoi_station.model import BoardType, FrameRecord, RecordingHead, Stitch, Verdict
from vaoi_station.rendering import ViewCalculator
from vaoi_station.runs.merging.merged_pictures import MergedAccess
from vaoi_station.runs.workers.merge_job import MergeJob, merge

EXPOSURES_US = (200.0, 20.0)
RADIANCE = 0.5


class Merging:
    """A run whose cameras alternate between two exposures of an even surface; one frame is incomplete."""

    def __init__(
        self, board_type: BoardType, stitch: Stitch, cameras: tuple[Camera, ...], flat_fields: Path | None = None
    ) -> None:
        rows = len(stitch.row_motion)
        records, self.pixels, self.jobs = [], {}, list[MergeJob]()
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
                grey = np.full((camera.height_px, camera.width_px), RADIANCE * exposure_us)
                self.pixels[slot] = np.round(grey).astype(np.uint8)
        self.gone = False
        heads = [{"width": c.width_px, "height": c.height_px, "exposure_us": 100.0} for c in cameras]
        head = {"format": "vaoi-recording", "version": 1, "cameras": heads, "rows": rows}
        self.finished: Any = SimpleNamespace(
            detail=SimpleNamespace(id="r1", frames=tuple(records)),
            board_type=board_type,
            cameras=cameras,
            stitch=stitch,
            result=stitch,
            view_calculator=ViewCalculator(board_type, stitch, cameras),
            head=RecordingHead.model_validate(head | {"trigger_period_s": 0.1, "conveyor_mm_s": (0.0, 100.0)}),
        )
        self.access = MergedAccess(lambda _: self.finished, self._lease, self._recorded, self._render, flat_fields)

    @contextmanager
    def _lease(self, run: str, purpose: str) -> Iterator[Any]:
        if self.gone:
            raise GoneError(f"The frames of run {run} are gone.")
        yield SimpleNamespace(number=1, generation=7)

    def _recorded(self, run: str, camera: int, row: int) -> Path | None:
        return None

    def _render(self, job: MergeJob, name: str) -> bytes:
        self.jobs.append(job)
        return merge(job, self.pixels.__getitem__)
