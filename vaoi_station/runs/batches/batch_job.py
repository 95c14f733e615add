"""The job of cutting one part of a batch, and its execution in a worker."""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from dataclasses import dataclass, field
from functools import lru_cache
from pathlib import Path
from typing import Any, NamedTuple, cast
from urllib.parse import quote

from numpy.typing import NDArray
from pydantic_core import to_json

from vaoi_station.errors import InputError, NotFoundError, StateError, VaoiError
from vaoi_station.files.images import read_kept_image
from vaoi_station.geometry import Camera
from vaoi_station.model import BoardType, Component, Stitch
from vaoi_station.rendering import (
    ChosenImages,
    FrameFacts,
    ImageRequest,
    View,
    ViewCalculator,
    choose_all,
    measure,
    render_chosen,
)
from vaoi_station.rendering.selection import describe
from vaoi_station.runs.batches.containers import ContainerName, Member, Packed, pack
from vaoi_station.runs.states.schemas import ImageFormat
from vaoi_station.runs.workers.jobs import PictureJob, Priority
from vaoi_station.runs.workers.picture_jobs import encode
from vaoi_station.stitching.matching.evidence import FrameKey

PART_BYTES = 1_500_000
"""Size at which a part ends, bytes. Only a single picture may make a part larger."""
PART_S = 0.04
"""CPU time after which a part ends, s, so that a job of a board that comes meanwhile never waits long."""
CHUNK = 16
"""Number of components whose views are computed at once."""
_FRAMES_HELD = 4
"""Number of frames of a recording that are kept decoded while a part is cut."""

MEDIA: dict[str, tuple[str, str]] = {
    "png": ("png", "image/png"),
    "jpeg": ("jpg", "image/jpeg"),
    "tiff": ("tif", "image/tiff"),
    "npy": ("npy", "application/x-npy"),
    "raw": ("raw", "application/octet-stream"),
}
"""For each format: suffix of file names, and media type."""


@dataclass(frozen=True)
class BatchSetup:
    """What all parts of a batch need. It is pickled once; a worker unpickles it once."""

    board_type: BoardType
    """Board type without its components; each job has those of its part."""
    stitch: Stitch
    """Result without its entries per component."""
    cameras: tuple[Camera, ...]
    facts: Mapping[FrameKey, FrameFacts]
    """How all frames of the run were taken."""
    usable: Mapping[FrameKey, int]
    """Slots of the frames that may be shown."""
    files: Mapping[FrameKey, Path]
    """Files of these frames in the run's recording; empty if the frames are in memory."""
    wanted: ImageRequest
    format: str
    container: ContainerName
    modified_s: int
    """Time of the files in the container, seconds since 1970."""
    address: str
    """Path of the run's components, to which addresses of pictures are relative; empty for a region."""
    query: str
    """Query of the addresses of pictures."""


class CutPart(NamedTuple):
    """The reply to a job: packed members, and where the rest begins; None if all is done."""

    packed: Packed
    images: int
    refused: int
    """Number of components that were refused."""
    rest: tuple[int, int] | None
    """Number of the component within the job, and of its image."""


@dataclass(frozen=True)
class BatchJob(PictureJob):
    """Cut the pictures of some components, of the first one from image `first` on; the reply's value is a `CutPart`."""

    setup: bytes
    """Pickled `BatchSetup`."""
    components: tuple[Component, ...]
    quality: Mapping[str, Mapping[str, Any]]
    """The entries of the result's quality for these components."""
    first: int = 0
    recorded: bool = False
    priority: Priority = field(default=Priority.BATCH, kw_only=True)

    def perform(self, frame: Callable[[int], NDArray[Any]]) -> CutPart:
        """Cut pictures until the part is large or has taken long; `frame` returns the pixels of a slot."""
        return _Cutting(self, frame).cut()

    def __str__(self) -> str:
        return f"a batch of pictures of run {self.run}, from {self.components[0].address} on"


class _Cutting:
    """The work of one job."""

    def __init__(self, job: BatchJob, frame: Callable[[int], NDArray[Any]]) -> None:
        self._job, self._frame = job, frame
        self._setup, self._calculator = _opened(job.setup)
        self._held: dict[FrameKey, NDArray[Any]] = {}
        stitch = self._setup.stitch
        self._stitch = stitch.model_copy(update={"quality": {**stitch.quality, **job.quality}})
        self._members: list[Member] = []
        self._images = self._refused = self._bytes = 0
        self._until_s = time.thread_time() + PART_S

    def cut(self) -> CutPart:
        rest = self._work()
        packed = pack(self._setup.container, self._members, self._setup.modified_s)
        return CutPart(packed, self._images, self._refused, rest)

    def _work(self) -> tuple[int, int] | None:
        """Make members until the part is full; return where the rest begins."""
        image, wanted = self._job.first, self._setup.wanted
        # A part that ends early must measure again what it had chosen and not rendered.
        chunk = 1 if wanted.needs_pixels or wanted.choice.measure else CHUNK
        for start in range(0, len(self._job.components), chunk):
            parts = self._job.components[start : start + chunk]
            for n, (part, chosen) in enumerate(zip(parts, self._choose(parts), strict=True), start):
                if (stopped := self._component(part, chosen, image)) is not None:
                    return n, stopped
                image = 0
                if self._full() and n + 1 < len(self._job.components):
                    return n + 1, 0
        return None

    def _full(self) -> bool:
        return self._bytes >= PART_BYTES or time.thread_time() > self._until_s

    def _put(self, member: Member) -> None:
        self._members.append(member)
        self._bytes += len(member.content)

    def _choose(self, parts: Sequence[Component]) -> Iterator[ChosenImages | VaoiError]:
        """Choose the images of each component. One that is refused does not prevent the others."""
        setup = self._setup
        run, frames = (setup.board_type, self._stitch), (setup.usable, setup.facts)
        try:
            yield from choose_all(
                self._calculator, parts, run, frames, setup.wanted, lambda view: measure(view, self._pixels(view))
            )
        except (InputError, NotFoundError, StateError) as error:  # frames that are lost end the batch
            if len(parts) == 1:
                yield error
                return
            for part in parts:
                yield from self._choose([part])

    def _component(self, part: Component, chosen: ChosenImages | VaoiError, first: int) -> int | None:
        """Make the members of a component from image `first` on; return the image at which the part is full."""
        folder = folder_of(part, region=not self._setup.address)
        if isinstance(chosen, VaoiError):
            self._refused += 1
            self._put(views_member(folder, refusal_entry(part, chosen)))
            return None
        suffix, media = MEDIA[self._setup.format]
        if first == 0:
            self._put(views_member(folder, self._entry(part, chosen, folder, suffix)))
        for k, choice in enumerate(chosen.chosen[first:], first):
            # Every job renders a picture, also if the choice alone has taken its time: otherwise a batch may never end.
            if k > first and self._full():
                return k
            other = None if choice.minus is None else self._pixels(choice.minus.view)
            picture = render_chosen(choice, self._pixels(choice.view), other)
            self._put(picture_member(f"{folder}/{k}.{suffix}", media, picture, self._setup.format))
            self._images += 1
        return None

    def _entry(self, part: Component, chosen: ChosenImages, folder: str, suffix: str) -> dict[str, Any]:
        rows = self._job.quality.get("component_covariance_px2", {}).get(part.address, ())
        certain = {(camera, row): ((xx, xy), (xy, yy)) for camera, row, xx, xy, yy in rows}
        views = []
        for k, choice in enumerate(chosen.chosen):
            covariance = chosen.covariance_px2(choice, certain.get((choice.view.camera, choice.view.row)))
            entry = {"k": k, "file": f"{folder}/{k}.{suffix}", **describe(choice, covariance)}
            if self._setup.address:
                entry["url"] = f"{self._setup.address}/{quote(part.address)}/images/{k}{self._setup.query}"
            if self._setup.format == "raw":
                # What a reader must know besides the size; lines follow each other without a gap.
                frame = self._pixels(choice.view)
                entry |= {"dtype": frame.dtype.name, "channels": 1 if frame.ndim == 2 else frame.shape[2]}
            views.append({name: value for name, value in entry.items() if value is not None})
        found: dict[str, Any] = {"address": part.address}
        if chosen.chosen:
            found["px_per_mm"] = chosen.chosen[0].view.px_per_mm
        if chosen.remark is not None:
            found["remark"] = chosen.remark
        return {**found, "views": views}

    def _pixels(self, view: View) -> NDArray[Any]:
        key = (view.camera, view.row)
        if not self._setup.files:
            return self._frame(self._setup.usable[key])
        if key not in self._held:
            if len(self._held) >= _FRAMES_HELD:
                del self._held[next(iter(self._held))]
            self._held[key] = read_kept_image(self._setup.files[key])
        return self._held[key]


def folder_of(part: Component, *, region: bool) -> str:
    """Return the folder of a component's files: ASCII, and never a path that leads out of the container."""
    if region:
        return part.ref
    steps = quote(part.address).split("/")
    return "/".join(["components", *(step.replace(".", "%2E") if not step.strip(".") else step for step in steps)])


def views_member(folder: str, entry: Mapping[str, Any]) -> Member:
    """Return the document of a component's pictures as a file."""
    return Member(f"{folder}/views.json", "application/json", to_json(entry))


def refusal_entry(part: Component, error: VaoiError) -> dict[str, Any]:
    """Return the document of a component that has no pictures because it was refused."""
    return {"address": part.address, "refused": refusal(error), "views": []}


def refusal(error: VaoiError) -> dict[str, str]:
    """Return an error as a part of a document."""
    return {"code": error.code, "message": error.message, "action": error.action}


def picture_member(name: str, media: str, image: NDArray[Any], format: str) -> Member:
    """Return a picture as a file; bare pixels state their size, pixel type and length of a line in headers."""
    height, width = image.shape[:2]
    channels = 1 if image.ndim == 2 else image.shape[2]
    headers = [("X-Image-Width", str(width)), ("X-Image-Height", str(height)), ("X-Image-Channels", str(channels))]
    if format != "raw":
        return Member(name, media, encode(image, cast("ImageFormat", format)), tuple(headers))
    headers += [
        ("X-Image-Dtype", image.dtype.name),
        ("X-Image-Stride", str(width * channels * image.dtype.itemsize)),
    ]
    # OpenCV stores colours as blue, green, red.
    pixels = image if image.ndim == 2 else image[..., ::-1]
    # One copy only: the largest picture in colour has 96 MB.
    return Member(name, media, pixels.tobytes(), tuple(headers))


@lru_cache(maxsize=2)
def _opened(setup: bytes) -> tuple[BatchSetup, ViewCalculator]:
    """Unpickle the set-up of a batch, which all its parts share."""
    opened: BatchSetup = pickle.loads(setup)
    return opened, ViewCalculator(opened.board_type, opened.stitch, opened.cameras)
