"""Jobs of a mosaic: the plan of a run, made once, and the pixels of a tile."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.files.images import encode_jpeg, encode_png
from vaoi_station.geometry import Camera
from vaoi_station.model import BoardType, Stitch
from vaoi_station.mosaic import FrameChoice, MosaicGrid, MosaicPlan, make_plan
from vaoi_station.mosaic.projection import FrameProjector
from vaoi_station.mosaic.tile_specs import TileSpec
from vaoi_station.mosaic.tiles import render_tile
from vaoi_station.runs.workers.jobs import FramesJob, Priority, SteppedJob
from vaoi_station.runs.workers.merge_job import opened_fields
from vaoi_station.steps import Steps

Slots = Mapping[tuple[int, int], int]
"""Slots of frames (camera, row)."""
ReadSlot = Callable[[int], NDArray[Any]]


@dataclass(frozen=True)
class PlanJob(SteppedJob):
    """Plan the mosaic of a run; the reply's value is a `MosaicPlan`. Of some hundred frames it takes seconds."""

    run: str
    bay: int
    generation: int
    slots: Slots
    choice: FrameChoice
    cameras: tuple[Camera, ...]
    """The cameras with which the run was stitched."""
    stitch: Stitch
    board_type: BoardType
    base: MosaicGrid
    flat_fields: Path | None = None
    """Directory of the flat fields; None: brightness follows from the overlaps of the frames alone."""
    request: int = 0
    priority: Priority = Priority.RENDER

    def steps(self, frame: ReadSlot) -> Steps[MosaicPlan]:
        """Survey the frames of the run, and return the plan."""
        return make_plan(
            self.choice,
            _reader(self.slots, frame),
            projector=FrameProjector(self.stitch, self.cameras),
            board_type=self.board_type,
            stitch=self.stitch,
            base=self.base,
            fields=opened_fields(self.flat_fields),
        )

    def __str__(self) -> str:
        return f"the plan of a mosaic of run {self.run}"


@dataclass(frozen=True)
class TileJob(FramesJob):
    """Render a tile of a mosaic; the reply's value is the encoded picture, or its pixels if `format` is None.

    Pixels are None if no frame shows any of the tile; an encoded picture is black there.
    """

    run: str
    bay: int
    generation: int
    slots: Slots
    """Slots of the frames that the tile needs."""
    spec: TileSpec
    tone: tuple[float, float]
    """Radiance of the darkest and the brightest places, for HDR as 8 bits."""
    format: str | None
    """`jpg`, `png`, or None."""
    request: int = 0
    priority: Priority = Priority.RENDER

    def perform(self, frame: ReadSlot) -> bytes | NDArray[Any] | None:
        """Render the tile."""
        picture = render_tile(self.spec, _reader(self.slots, frame))
        if self.format is None:
            return picture
        if picture is None:
            picture = np.zeros((self.spec.height, self.spec.width), np.uint8)
        elif self.spec.hdr:
            picture = displayed(picture, self.tone)
        return encode_jpeg(picture) if self.format == "jpg" else encode_png(picture)

    def __str__(self) -> str:
        return f"a tile of the mosaic of run {self.run}"


def displayed(radiance: NDArray[np.float32], tone: tuple[float, float]) -> NDArray[np.uint8]:
    """Return radiance as 8 bits, by its logarithm between the darkest and the brightest places; 0 where it is NaN."""
    low, high = tone
    seen = np.isfinite(radiance)
    clipped = np.clip(np.where(seen, radiance, low), low, high)
    share = cv2.log(np.asarray(clipped / low, np.float32)) / max(float(np.log(high / low)), 1e-6)
    return np.asarray(np.where(seen, 1 + np.rint(254 * share), 0), np.uint8)


def _reader(slots: Slots, frame: ReadSlot) -> Callable[[int, int], NDArray[Any] | None]:
    def read(camera: int, row: int) -> NDArray[Any] | None:
        slot = slots.get((camera, row))
        return None if slot is None else frame(slot)

    return read
