"""The job of reading the codes of a run, in slices, and its execution in a worker."""

from __future__ import annotations

import time
from collections.abc import Callable, Mapping
from dataclasses import dataclass
from typing import Any, NamedTuple

from numpy.typing import NDArray

from vaoi_station.geometry import Camera
from vaoi_station.identity.code_reader import CodeReader, Progress
from vaoi_station.identity.region_pictures import RegionPictures
from vaoi_station.model import BoardReading, BoardType, Stitch
from vaoi_station.runs.workers.jobs import FramesJob, Priority
from vaoi_station.stitching.matching.evidence import FrameKey

SLICE_S = 0.03
"""Time after the begin of a slice in which further pictures are begun, so that no other job waits for long."""


class IdentitySlice(NamedTuple):
    """The result of one slice."""

    progress: Progress
    reading: BoardReading
    """What is read by now."""
    worker_s: float
    """Time that the worker took."""


@dataclass(frozen=True)
class IdentityJob(FramesJob):
    """Try to read codes in one picture of a run, and in further ones until `SLICE_S` have passed.

    The reply's value is an `IdentitySlice`.
    """

    run: str
    bay: int
    generation: int
    board_type: BoardType
    """The board type without its components, so that the message is small."""
    stitch: Stitch
    cameras: tuple[Camera, ...]
    slots: Mapping[FrameKey, int]
    """Slots of the usable frames."""
    progress: Progress = Progress()  # noqa: RUF009  it is immutable
    request: int = 0

    priority = Priority.IDENTITY

    def perform(self, frame: Callable[[int], NDArray[Any]]) -> IdentitySlice:
        """Try further pictures; `frame` returns the pixels of a slot."""
        began_s = time.monotonic()

        def pixels(camera: int, row: int) -> NDArray[Any] | None:
            slot = self.slots.get((camera, row))
            return None if slot is None else frame(slot)

        pictures = RegionPictures(self.board_type, self.stitch, self.cameras, [*self.slots], pixels)
        reader = CodeReader(self.board_type, pictures)
        progress = reader.work(self.progress, lambda: time.monotonic() - began_s < SLICE_S)
        return IdentitySlice(progress, reader.reading(progress), time.monotonic() - began_s)

    def __str__(self) -> str:
        return f"the codes of run {self.run}"
