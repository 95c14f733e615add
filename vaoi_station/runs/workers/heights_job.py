"""The jobs of measuring the heights of all components of a run, in slices, and their execution in a worker."""

from __future__ import annotations

import json
import math
import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

from numpy.typing import NDArray

from vaoi_station.geometry import Camera
from vaoi_station.heights.comparison import heights_document
from vaoi_station.heights.equalised_frames import equalised_frames
from vaoi_station.heights.estimates import PartMeasure, combine_parts, measure_part, open_places
from vaoi_station.heights.part_grids import Frames
from vaoi_station.model import BoardType, Stitch
from vaoi_station.runs.workers.jobs import FramesJob, Priority
from vaoi_station.runs.workers.merge_job import opened_fields
from vaoi_station.stitching.matching.evidence import FrameKey

SLICE_S = 0.03
"""Time after the first component in which further ones are begun, so that no other job waits for long.

The first component is not counted: with it, frames of 16 bits or colour are converted, and frames are divided by flat
fields, which later components use.
"""


@dataclass(frozen=True)
class HeightsJob(FramesJob):
    """Measure a component of a run, and further ones until `SLICE_S` have passed.

    The reply's value is a dict of `PartMeasure`s by address: those of the first components of `board_type`.
    """

    run: str
    bay: int
    generation: int
    board_type: BoardType
    """The board type with the components of this slice only, so that the message is small."""
    stitch: Stitch
    cameras: tuple[Camera, ...]
    lights: tuple[str, ...]
    """Name of the light of every row; empty if all rows have one."""
    slots: Mapping[FrameKey, int]
    """Slots of the usable frames."""
    flat_fields: Path | None = None
    """Directory of the flat fields by which frames are divided."""
    priority: Priority = Priority.RENDER
    request: int = 0

    def perform(self, frame: Callable[[int], NDArray[Any]]) -> dict[str, PartMeasure]:
        """Measure components; `frame` returns the pixels of a slot."""

        def pixels(camera: int, row: int) -> NDArray[Any] | None:
            slot = self.slots.get((camera, row))
            return None if slot is None else frame(slot)

        places, frames = open_places(self.board_type, self.stitch, self.cameras), Frames(pixels)
        if self.flat_fields is not None:
            frames = Frames(equalised_frames(pixels, opened_fields(self.flat_fields), self.lights))
        found: dict[str, PartMeasure] = {}
        ends_s = math.inf
        for component in self.board_type.components:
            found[component.address] = measure_part(places, frames, component, self.lights)
            now_s = time.monotonic()
            ends_s = min(ends_s, now_s + SLICE_S)
            if now_s > ends_s:
                break
        return found

    def __str__(self) -> str:
        return f"heights of components of run {self.run}"


@dataclass(frozen=True)
class CombineHeightsJob(FramesJob):
    """Combine the measured components of a run; the reply's value is the document of their heights (JSON)."""

    run: str
    bay: int
    generation: int
    board_type: BoardType
    stitch: Stitch
    parts: Mapping[str, PartMeasure]
    priority: Priority = Priority.RENDER
    request: int = 0

    def perform(self, frame: Callable[[int], NDArray[Any]]) -> bytes:  # noqa: ARG002  frames are not needed
        """Combine the components; no frame is read."""
        document = heights_document(combine_parts(self.parts, self.stitch), self.board_type)
        # Fields without a value are left out of replies.
        entries = {ref: {k: v for k, v in entry.items() if v is not None} for ref, entry in document.items()}
        return json.dumps({"heights": entries}).encode()

    def __str__(self) -> str:
        return f"the table of heights of run {self.run}"
