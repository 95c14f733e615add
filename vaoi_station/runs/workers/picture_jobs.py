"""Jobs on the frames of a finished run: pictures, merged pictures, mosaics, heights, codes, checks of board types."""

from __future__ import annotations

import io
import json
import math
import time
from collections.abc import Callable, Iterable, Mapping
from dataclasses import dataclass, field
from functools import lru_cache, partial
from pathlib import Path
from typing import Any, ClassVar, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.board_check.check import check_board, picture_of_check
from vaoi_station.board_check.overview import CheckedRun
from vaoi_station.board_check.report import BoardCheck
from vaoi_station.files.images import encode_jpeg, encode_png, encode_tiff, read_kept_image
from vaoi_station.frame_index import FrameIndex
from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.hdr import Exposed
from vaoi_station.hdr.encoding import encode_merged
from vaoi_station.hdr.merging import Body, merge_region
from vaoi_station.hdr.row_levels import row_levels
from vaoi_station.heights.estimates import (
    PartMeasure,
    combine_parts,
    equalised_frames,
    heights_document,
    measure_part,
    open_places,
)
from vaoi_station.heights.pictures import Frames as PartFrames
from vaoi_station.identity.code_reader import CodeReader, Progress, RegionPictures
from vaoi_station.model import BoardReading, BoardType, Stitch
from vaoi_station.mosaic import FrameChoice, MosaicGrid, MosaicPlan, TileRenderer, make_plan
from vaoi_station.mosaic.gains import COARSE_PX
from vaoi_station.mosaic.reduction import Reduced, ReducedFrames
from vaoi_station.mosaic.tile_specs import TileSpec
from vaoi_station.mosaic.tiles import NODATA, Frames, render_tile
from vaoi_station.photometry import FlatFields, Taken, WhiteBalance
from vaoi_station.photometry.flat_fields import changed_ns
from vaoi_station.rendering import View, render
from vaoi_station.rendering.temporary import subtract
from vaoi_station.runs.states.schemas import ImageFormat
from vaoi_station.runs.workers.jobs import PictureJob, Priority, ReadSlot, SteppedJob
from vaoi_station.runs.workers.second_compiler import later_code_is_there
from vaoi_station.steps import Steps
from vaoi_station.stitching.matching.evidence import FrameKey

Slots = Mapping[FrameKey, int]
"""Slots of frames (camera, row)."""
SLICE_S = 0.03
"""Time in which a job in slices begins further parts of its work, so that no other job waits for long."""
OVERVIEW_PX = 5_000_000
"""Largest number of pixels of an overview: of a board of 262 megapixels, the level that is reduced by 8."""
_BLOCK_PX = 512
"""Side of the parts in which an overview is made, each in a step of some milliseconds."""
MOST_DECODED = 500_000_000
"""Largest number of pixels that a comparison of rows decodes from files: more would take a worker longer than it may.
Frames in memory are not decoded, and only the windows that are compared are read."""


def reader(slots: Slots, frame: ReadSlot) -> Callable[[int, int], NDArray[Any] | None]:
    """Return a function that returns the pixels of a camera and row, None for a frame without a slot."""

    def read(camera: int, row: int) -> NDArray[Any] | None:
        slot = slots.get((camera, row))
        return None if slot is None else frame(slot)

    return read


def _pixels(frame: ReadSlot, slot: int, file: Path | None) -> NDArray[Any]:
    return frame(slot) if file is None else read_kept_image(file)


def opened_fields(directory: Path | None) -> FlatFields:
    """Return flat fields, which are read again when their document changes; without a directory, neutral ones."""
    return FlatFields.none() if directory is None else _opened(directory, changed_ns(directory))


@lru_cache(maxsize=1)
def _opened(directory: Path, _changed_ns: int) -> FlatFields:
    return FlatFields.open(directory)


def encode(image: NDArray[Any], format: ImageFormat) -> bytes:
    """Encode an image, and return the content of the image file."""
    match format:
        case "png":
            return encode_png(image)
        case "jpeg":
            return encode_jpeg(image)
        case "tiff":
            return encode_tiff(image)
        case "npy":
            file = io.BytesIO()
            # OpenCV stores colours as blue, green, red.
            np.save(file, image if image.ndim == 2 else np.ascontiguousarray(image[..., ::-1]))
            return file.getvalue()


# --- temporary images


@dataclass(frozen=True)
class RenderJob(PictureJob):
    """Render one temporary image; the reply's value is the encoded file.

    `bay`, `generation` and `slot` are the place of the frame in the ring. They have no meaning if `file` is given.
    """

    slot: int
    view: View
    format: ImageFormat
    file: Path | None = None
    """File of the frame in the run's recording, if its memory was given to a later board; None for a frame in the
    ring."""
    minus: RenderJob | None = None
    """The picture that is subtracted from this one (`rendering.temporary.subtract`); None for a plain picture."""
    ratio: float = 1.0
    """Factor on the grey levels of `minus`."""
    white_balance: WhiteBalance | None = None

    @property
    def recorded(self) -> bool:
        """Whether the frame is read from a file."""
        return self.file is not None

    def perform(self, frame: ReadSlot) -> bytes:
        """Render and encode the picture."""
        return encode(self._picture(frame), self.format)

    def _picture(self, frame: ReadSlot) -> NDArray[Any]:
        picture = render(self.view, _pixels(frame, self.slot, self.file), self.white_balance)
        return picture if self.minus is None else subtract(picture, self.minus._picture(frame), self.ratio)

    def __str__(self) -> str:
        return f"a picture from camera {self.view.camera}, row {self.view.row} of run {self.run}"


class MergedFrame(NamedTuple):
    """One frame of a merge: its view, how it was taken, its size in px, and its slot in the ring or its file."""

    view: View
    taken: Taken
    size: tuple[int, int]
    slot: int
    file: Path | None = None


class MergedBody(NamedTuple):
    """A body in the picture of a region, with its frames in the plane of its top."""

    body: Body
    frames: tuple[MergedFrame, ...]


@dataclass(frozen=True)
class MergeJob(RenderJob):
    """Merge frames to linear radiance; the reply's value is the encoded picture.

    `slot` and `view` are those of the best frame.
    """

    longest_s: ClassVar[float | None] = 120.0
    frames: tuple[MergedFrame, ...] = ()
    bodies: tuple[MergedBody, ...] = ()
    """Bodies in the picture of a region."""
    flat_fields: Path | None = None
    """Directory of the flat fields; None: the flat is 1 and the dark level 0."""
    sigma: bool = False
    """Whether the standard deviation is returned in place of the radiance."""

    def perform(self, frame: ReadSlot) -> bytes:
        """Merge the frames, and encode the picture."""
        fields = opened_fields(self.flat_fields)

        def exposed(frames: Iterable[MergedFrame]) -> list[Exposed]:
            return [
                Exposed(
                    f.view,
                    f.taken,
                    fields.maps(f.view.camera, f.taken.light),
                    f.size,
                    partial(_pixels, frame, f.slot, f.file),
                )
                for f in frames
            ]

        bodies = [(of.body, exposed(of.frames)) for of in self.bodies]
        picture = merge_region(exposed(self.frames), bodies, groups=False, sigma=self.sigma)[-1]
        return encode_merged(picture.sigma if self.sigma else picture.value, self.format)

    def __str__(self) -> str:
        return f"a picture merged of {len(self.frames)} frames of run {self.run}"


class LevelFrame(NamedTuple):
    """A frame of a run: how it was taken, its slot in the ring, or its file."""

    camera: int
    row: int
    taken: Taken
    slot: int
    file: Path | None = None


@dataclass(frozen=True)
class RowLevelsJob(PictureJob):
    """Estimate the brightness of the rows of a run; the reply's value is (m,) factors."""

    what: ClassVar[str] = "the brightness of the rows"
    longest_s: ClassVar[float | None] = 120.0
    frames: tuple[LevelFrame, ...]
    board_type: BoardType
    stitch: Stitch
    cameras: tuple[Camera, ...]
    """The cameras with which the run was stitched."""
    flat_fields: Path
    recorded: bool = False

    def perform(self, frame: ReadSlot) -> Floats:
        """Compare the rows."""
        frames = {(f.camera, f.row): f for f in self.frames}

        def pixels(camera: int, row: int) -> NDArray[Any]:
            wanted = frames[camera, row]
            return _pixels(frame, wanted.slot, wanted.file)

        taken = {key: f.taken for key, f in frames.items()}
        fields = opened_fields(self.flat_fields)
        most = MOST_DECODED if self.recorded else math.inf
        return row_levels(taken, self.board_type, self.stitch, self.cameras, fields, pixels, most)


# --- the whole board


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

    what: ClassVar[str] = "the plan of a mosaic"
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

    def steps(self, frame: ReadSlot) -> Steps[PlannedPicture]:
        """Survey the frames of the run, make the plan and by it the picture, from the reduced frames of the survey."""
        while not later_code_is_there():
            # more urgent jobs come in between
            time.sleep(SLICE_S)
            yield
        read, projector = reader(self.slots, frame), FrameIndex.of_result(self.stitch, self.cameras)
        reduction = 1
        while self.grid.width * self.grid.height > OVERVIEW_PX * reduction**2:
            reduction *= 2
        copies: dict[FrameKey, Reduced] = {}
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


@dataclass(frozen=True)
class TileJob(PictureJob):
    """Render a tile of a mosaic; the reply's value is the encoded picture, or its pixels if `format` is None.

    Pixels are None if no frame shows any of the tile; an encoded picture is black there.
    """

    what: ClassVar[str] = "a tile of the mosaic"
    slots: Slots
    """Slots of the frames that the tile needs."""
    spec: TileSpec
    tone: tuple[float, float]
    """Radiance of the darkest and the brightest places, for HDR as 8 bits."""
    format: str | None
    """`jpg`, `png`, or None."""

    def perform(self, frame: ReadSlot) -> bytes | NDArray[Any] | None:
        """Render the tile."""
        picture = render_tile(self.spec, reader(self.slots, frame))
        if self.format is None:
            return picture
        if picture is None:
            picture = np.zeros((self.spec.height, self.spec.width), np.uint8)
        elif self.spec.hdr:
            picture = displayed(picture, self.tone)
        return encode_jpeg(picture) if self.format == "jpg" else encode_png(picture)


def _whole(renderer: TileRenderer, frames: Frames) -> Steps[NDArray[Any] | None]:
    width, height = renderer.grid.width, renderer.grid.height
    whole = None
    for y, x in np.ndindex(-(-height // _BLOCK_PX), -(-width // _BLOCK_PX)):
        x0, y0 = x * _BLOCK_PX, y * _BLOCK_PX
        box = x0, y0, min(x0 + _BLOCK_PX, width), min(y0 + _BLOCK_PX, height)
        part = render_tile(renderer.spec(box), frames)
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


# --- heights and codes


@dataclass(frozen=True)
class HeightsJob(PictureJob):
    """Measure a component of a run, and further ones until `SLICE_S` have passed.

    The reply's value is a dict of `PartMeasure`s by address: those of the first components of `board_type`. It is empty
    while the code is compiled.
    """

    what: ClassVar[str] = "heights of components"
    board_type: BoardType
    """The board type with the components of this slice only, so that the message is small."""
    stitch: Stitch
    cameras: tuple[Camera, ...]
    lights: tuple[str, ...]
    """Name of the light of every row; empty if all rows have one."""
    slots: Slots
    """Slots of the usable frames."""
    flat_fields: Path | None = None
    """Directory of the flat fields by which frames are divided."""

    def perform(self, frame: ReadSlot) -> dict[str, PartMeasure]:
        """Measure components."""
        if not later_code_is_there():
            time.sleep(SLICE_S)
            return {}
        pixels = reader(self.slots, frame)
        places, frames = open_places(self.board_type, self.stitch, self.cameras), PartFrames(pixels)
        if self.flat_fields is not None:
            frames = PartFrames(equalised_frames(pixels, opened_fields(self.flat_fields), self.lights))
        measures: dict[str, PartMeasure] = {}
        # The time of the first component does not count: with it, frames are converted and divided by flat fields,
        # which later components use.
        ends_s = math.inf
        for component in self.board_type.components:
            measures[component.address] = measure_part(places, frames, component, self.lights)
            now_s = time.monotonic()
            ends_s = min(ends_s, now_s + SLICE_S)
            if now_s > ends_s:
                break
        return measures


@dataclass(frozen=True)
class CombineHeightsJob(PictureJob):
    """Combine the measured components of a run; the reply's value is the document of their heights (JSON)."""

    what: ClassVar[str] = "the table of heights"
    board_type: BoardType
    stitch: Stitch
    parts: Mapping[str, PartMeasure]

    def perform(self, frame: ReadSlot) -> bytes:  # noqa: ARG002  frames are not needed
        """Combine the components; no frame is read."""
        document = heights_document(combine_parts(self.parts, self.stitch), self.board_type)
        # Fields without a value are left out of replies.
        entries = {ref: {k: v for k, v in entry.items() if v is not None} for ref, entry in document.items()}
        return json.dumps({"heights": entries}).encode()


class IdentitySlice(NamedTuple):
    """The result of one slice."""

    progress: Progress
    reading: BoardReading
    """What is read by now."""
    worker_s: float
    """Time that the worker took."""


@dataclass(frozen=True)
class IdentityJob(PictureJob):
    """Try to read codes in one picture of a run, and in further ones until `SLICE_S` have passed.

    The reply's value is an `IdentitySlice`.
    """

    what: ClassVar[str] = "the codes"
    board_type: BoardType
    """The board type without its components, so that the message is small."""
    stitch: Stitch
    cameras: tuple[Camera, ...]
    slots: Slots
    """Slots of the usable frames."""
    progress: Progress = Progress()  # noqa: RUF009  it is immutable
    priority: Priority = field(default=Priority.IDENTITY, kw_only=True)

    def perform(self, frame: ReadSlot) -> IdentitySlice:
        """Try further pictures."""
        began_s = time.monotonic()
        pictures = RegionPictures(self.board_type, self.stitch, self.cameras, [*self.slots], reader(self.slots, frame))
        codes = CodeReader(self.board_type, pictures)
        progress = codes.work(self.progress, lambda: time.monotonic() - began_s < SLICE_S)
        return IdentitySlice(progress, codes.reading(progress), time.monotonic() - began_s)


class CheckedBoard(NamedTuple):
    """The report of a checked board type, and the picture as JPEG."""

    report: BoardCheck
    picture: bytes


@dataclass(frozen=True)
class BoardCheckJob(PictureJob):
    """Lay a board type over a run; the reply's value is a `CheckedBoard`."""

    slots: Slots
    """Slots of the usable frames."""
    stitch: Stitch
    cameras: tuple[Camera, ...]
    """The cameras with which the run was stitched."""
    lights: tuple[str, ...]
    """Name of the light of every row; empty if all rows have one."""
    own: BoardType
    """The board type with which the run was stitched."""
    board_type: BoardType
    """The board type that is checked."""
    # It takes seconds, so everything else comes first; a second worker would take as long.
    priority: Priority = field(default=Priority.HEIGHTS, kw_only=True)
    repeatable: ClassVar[bool] = False
    longest_s: ClassVar[float | None] = 180.0

    def perform(self, frame: ReadSlot) -> CheckedBoard:
        """Check the board type."""
        pixels = reader(self.slots, frame)
        run = CheckedRun(self.stitch, self.stitch.cameras(self.cameras), pixels, self.lights, self.own)
        report = check_board(run, self.board_type)
        return CheckedBoard(report, encode_jpeg(picture_of_check(run, self.board_type, report)))

    def __str__(self) -> str:
        return f"the check of board type {self.board_type.name!r} against run {self.run}"
