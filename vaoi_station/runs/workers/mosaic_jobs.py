"""Jobs of a mosaic: the plan of a run with the largest level of its overview, made once, and the pixels of a tile."""

from __future__ import annotations

from collections.abc import Callable, Mapping
from dataclasses import dataclass
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.files.images import encode_jpeg, encode_png
from vaoi_station.geometry import Camera
from vaoi_station.model import BoardType, Stitch
from vaoi_station.mosaic import FrameChoice, MosaicGrid, MosaicPlan, TileRenderer, make_plan
from vaoi_station.mosaic.projection import FrameProjector
from vaoi_station.mosaic.reduction import Reduced, ReducedFrames
from vaoi_station.mosaic.survey import COARSE_PX
from vaoi_station.mosaic.tile_specs import TileSpec
from vaoi_station.mosaic.tiles import NODATA, Frames, Scratch, render_tile
from vaoi_station.runs.workers.jobs import FramesJob, Priority, SteppedJob
from vaoi_station.runs.workers.merge_job import opened_fields
from vaoi_station.steps import Steps

Slots = Mapping[tuple[int, int], int]
"""Slots of frames (camera, row)."""
ReadSlot = Callable[[int], NDArray[Any]]
OVERVIEW_PX = 5_000_000
"""Largest number of pixels of an overview: of a board of 262 megapixels, the level that is reduced by 8."""
_BLOCK_PX = 512
"""Side of the parts in which an overview is made, each in a step of some milliseconds."""


class PlannedPicture(NamedTuple):
    """A plan, and the mosaic at low resolution."""

    plan: MosaicPlan
    reduction: int
    """By how much the picture is reduced, a power of two."""
    picture: NDArray[Any] | None
    """(h, w) or (h, w, 3), 0 where no frame shows the board; None with HDR, and if no frame shows any of it."""


@dataclass(frozen=True)
class PlanJob(SteppedJob):
    """Plan the mosaic of a run; the reply's value is a `PlannedPicture`. Of some hundred frames it takes seconds."""

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
    """The grid of the plan."""
    grid: MosaicGrid
    """The largest grid of the mosaic."""
    flat_fields: Path | None = None
    """Directory of the flat fields; None: brightness follows from the overlaps of the frames alone."""
    request: int = 0
    priority: Priority = Priority.RENDER

    def steps(self, frame: ReadSlot) -> Steps[PlannedPicture]:
        """Survey the frames of the run, make the plan and by it the picture, from the reduced frames of the survey."""
        read, projector = _reader(self.slots, frame), FrameProjector(self.stitch, self.cameras)
        reduction = 1
        while self.grid.width * self.grid.height > OVERVIEW_PX * reduction**2:
            reduction *= 2
        copies: dict[tuple[int, int], Reduced] = {}
        wanted = not self.choice.hdr
        plan = yield from make_plan(
            self.choice,
            read,
            projector=projector,
            board_type=self.board_type,
            stitch=self.stitch,
            base=self.base,
            fields=opened_fields(self.flat_fields),
            copies=copies if wanted and reduction >= COARSE_PX else None,
        )
        if not wanted:
            return PlannedPicture(plan, reduction, None)
        frames = ReducedFrames(COARSE_PX, copies) if reduction >= COARSE_PX else read
        picture = yield from _whole(TileRenderer(plan, projector, self.grid.reduced(reduction)), frames)
        return PlannedPicture(plan, reduction, picture)

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


def _whole(renderer: TileRenderer, frames: Frames) -> Steps[NDArray[Any] | None]:
    """Render a small mosaic as a whole; None if no frame shows any of it."""
    width, height = renderer.grid.width, renderer.grid.height
    whole, memory = None, Scratch()
    for y, x in np.ndindex(-(-height // _BLOCK_PX), -(-width // _BLOCK_PX)):
        x0, y0 = x * _BLOCK_PX, y * _BLOCK_PX
        box = x0, y0, min(x0 + _BLOCK_PX, width), min(y0 + _BLOCK_PX, height)
        part = render_tile(renderer.spec(box), frames, memory)
        if part is not None:
            if whole is None:
                whole = np.full((height, width, *part.shape[2:]), NODATA, part.dtype)
            whole[box[1] : box[3], box[0] : box[2]] = part
        yield
    return whole


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
