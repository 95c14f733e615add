"""The job of measuring the heights of all components of a run, and its execution in a worker."""

from __future__ import annotations

import json
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any

from numpy.typing import NDArray

from vaoi_station.geometry import Camera
from vaoi_station.heights.comparison import heights_document
from vaoi_station.heights.estimates import measure_heights
from vaoi_station.model import BoardType, Stitch
from vaoi_station.runs.workers.jobs import FramesJob
from vaoi_station.stitching.matching.evidence import FrameKey


@dataclass(frozen=True)
class HeightsJob(FramesJob):
    """Measure the heights of all components of a run; the reply's value is their document (JSON).

    It waits with the pictures, after all results.
    """

    run: str
    bay: int
    generation: int
    board_type: BoardType
    stitch: Stitch
    cameras: tuple[Camera, ...]
    lights: tuple[str, ...]
    """Name of the light of every row; empty if all rows have one."""
    slots: Mapping[FrameKey, int]
    """Slots of the usable frames."""
    request: int = 0

    def perform(self, frame: Callable[[int], NDArray[Any]]) -> bytes:
        """Measure the heights; `frame` returns the pixels of a slot."""

        def pixels(camera: int, row: int) -> NDArray[Any] | None:
            slot = self.slots.get((camera, row))
            return None if slot is None else frame(slot)

        found = measure_heights(self.board_type, self.stitch, self.cameras, pixels, self.lights)
        document = heights_document(found, self.board_type)
        # Fields without a value are left out of replies.
        entries = {ref: {k: v for k, v in entry.items() if v is not None} for ref, entry in document.items()}
        return json.dumps({"heights": entries}).encode()

    def __str__(self) -> str:
        return f"the heights of components of run {self.run}"
