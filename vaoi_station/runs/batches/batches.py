"""Batches of a station: what a request needs is prepared once; each part is cut by a worker under a lease of its own.

The lease lasts for one part, so that a caller who reads slowly does not keep memory from the next boards. If the frames
are evicted meanwhile, the batch ends with a document that says so.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping, Sequence
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, field, replace
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from pydantic_core import to_json

from vaoi_station.errors import GoneError, InputError, NotFoundError, VaoiError
from vaoi_station.hdr.encoding import MergedFormat
from vaoi_station.hdr.merging import region_component
from vaoi_station.model import BoardType, Component
from vaoi_station.model.stitch_result import Heights, with_heights
from vaoi_station.rendering import ImageRequest, choose_all
from vaoi_station.runs.archive.component_views import component_of, tables_of
from vaoi_station.runs.archive.finished_runs import FinishedRun
from vaoi_station.runs.archive.recordings import recorded_files
from vaoi_station.runs.batches.batch_job import (
    MEDIA,
    BatchJob,
    BatchSetup,
    CutPart,
    folder_of,
    refusal,
    refusal_entry,
    views_member,
)
from vaoi_station.runs.batches.containers import CONTAINERS, ContainerName, Member, Packed, pack
from vaoi_station.runs.merging.merged_pictures import MergedAccess, MergedChoice, MergeRequest
from vaoi_station.runs.run.memory import Bay
from vaoi_station.runs.states.schemas import RunDetail
from vaoi_station.stitching.matching.evidence import FrameKey
from vaoi_station.version import __version__

Corners = tuple[float, float, float, float]
_OF_MERGES = ("light", "px_per_mm", "min_coverage")
FIRST_PARTS = (4, 8, 16, 32)
"""Numbers of components of the first parts; they are small, so that the first picture comes early."""
PART_COMPONENTS = 64
"""Number of components of all later parts; a part ends before them when it is large."""


@dataclass(frozen=True)
class BatchRequest:
    """A request for the pictures of many components. At most one of the first three fields is given."""

    components: tuple[str, ...] = ()
    """Addresses; empty: all components."""
    within: Corners | None = None
    """Only components whose centre lies in this box: x0, y0, x1, y1 in CAD coordinates."""
    region: Corners | None = None
    """One picture per frame of this part of the board, in place of components."""
    images: ImageRequest = field(default_factory=ImageRequest)
    hdr: bool = False
    """One picture per component, merged of all its frames under one light, in place of one per frame."""
    format: str = "png"
    container: ContainerName = "multipart"

    def check(self) -> BatchRequest:
        """Return the request. Raise InputError if fields contradict each other or have values that do not exist."""
        given = [name for name in ("components", "within", "region") if getattr(self, name)]
        if len(given) > 1:
            raise InputError(
                f"batch: {given[0]} and {given[1]} are given together.", action="Give one of them, or none for all."
            )
        if self.container not in CONTAINERS:
            raise InputError.field("batch", "container", self.container, f"one of {', '.join(CONTAINERS)}")
        if self.format not in MEDIA:
            raise InputError.field("batch", "format", self.format, f"one of {', '.join(MEDIA)}")
        self.images.check()
        if self.hdr and (other := sorted(set(self.images.options()) - set(_OF_MERGES))):
            raise InputError(
                f"batch: {other[0]} has no meaning with hdr, whose pictures are merged of all frames of a light.",
                action=f"Give only {', '.join(_OF_MERGES)} with hdr.",
            )
        return self

    def parts(self, board_type: BoardType, px_per_mm: float) -> tuple[Component, ...]:
        """Return the components of the request. `px_per_mm` is the resolution of a region without one of its own.

        Raises:
            NotFoundError: a component is unknown.
            InputError: a box has no area or no component, or the region is off the board or too large.
        """
        if self.region is not None:
            resolution = self.images.framing.px_per_mm or px_per_mm
            return (region_component(self.region, board_type, resolution, "batch: region"),)
        if self.components:
            return tuple(component_of(board_type, ref) for ref in dict.fromkeys(self.components))
        if self.within is None:
            return board_type.components
        x0, y0, x1, y1 = self.within
        found = tuple(c for c in board_type.components if x0 <= c.center[0] <= x1 and y0 <= c.center[1] <= y1)
        if not found:
            shown = " ".join(f"{v:g}" for v in self.within)
            limit = f"a box x0,y0,x1,y1 around the centre of at least one component ({board_type.unit}, CAD)"
            raise InputError.field("batch", "within", shown, limit)
        return found

    def of_merge(self, part: Component) -> MergeRequest:
        """Return the request for the merged picture of a component, or of the region."""
        light, resolution = self.images.choice.light, self.images.framing.px_per_mm
        address = part.address if self.region is None else None
        return MergeRequest(address, self.region, light, resolution, self.images.options().get("min_coverage"))


def smallest(parts: Sequence[Component]) -> Component:
    """Return the component with the smallest picture. A request that it refuses is refused by all."""
    return parts[int(np.argmin([part.width * part.height for part in parts]))]


class BatchPart(NamedTuple):
    """Components that are cut next, and the image with which the first one begins."""

    components: tuple[Component, ...]
    image: int = 0


@dataclass(frozen=True)
class Batch:
    """A batch that can be cut: the components in their order, and what all parts share."""

    run: str
    request: BatchRequest
    components: tuple[Component, ...]
    setup: BatchSetup
    head: Member
    """The first file: what the batch is of."""
    tables: Callable[[], Mapping[str, Mapping[str, Any]]]
    """Function that reads the entries of the result's quality that have one value per component."""

    @cached_property
    def prepared(self) -> tuple[bytes, Mapping[str, Mapping[str, Any]]]:
        """The pickled set-up and the tables that all parts need; both take time, and the head is sent before."""
        return pickle.dumps(self.setup, pickle.HIGHEST_PROTOCOL), self.tables()

    @property
    def modified_s(self) -> int:
        """Time of the files in the container, seconds since 1970."""
        return self.setup.modified_s

    def parts(self) -> list[BatchPart]:
        """Return the parts of the batch, in the order of the components."""
        if self.request.hdr:
            return [BatchPart((part,)) for part in self.components]
        found, start, sizes = [], 0, iter(FIRST_PARTS)
        while start < len(self.components):
            size = next(sizes, PART_COMPONENTS)
            found.append(BatchPart(self.components[start : start + size]))
            start += size
        return found

    def pack(self, *members: Member) -> Packed:
        """Return files as bytes of the batch's container."""
        return pack(self.request.container, members, self.modified_s)

    def end(self, images: int, refused: int, error: VaoiError | None) -> Member:
        """Return the last file. Without it, or if `complete` is false in it, pictures are missing."""
        document: dict[str, Any] = {
            "complete": error is None,
            "components": len(self.components),
            "refused": refused,
            "images": images,
        }
        if error is not None:
            document["error"] = refusal(error)
        return Member("end.json", "application/json", to_json(document))


@dataclass(frozen=True)
class BatchAccess:
    """Prepares batches, and has their parts cut by workers. Methods may be called from any thread."""

    get: Callable[[str], FinishedRun]
    """Function that returns a finished run."""
    explained: Callable[[str], FinishedRun]
    """Function that returns a finished run with its complete result, and waits for that if need be."""
    lease: Callable[[str, str], AbstractContextManager[Bay]]
    """Function that keeps a run's frames in memory in a `with` block."""
    recorded: Callable[[str, int, int], Path | None]
    """Function that returns the file of a frame in the run's recording; None if no recording is kept."""
    render: Callable[[BatchJob, str], CutPart]
    """Function that submits a job and waits for the reply's value."""
    merged: MergedAccess
    heights: Callable[[str], Heights | None] = lambda _run: None
    """Function that returns the measured heights of a run's components."""
    published: Callable[[RunDetail], RunDetail] = lambda detail: detail
    """Function that returns the document of a run as callers see it."""

    def open(self, run: str, request: BatchRequest, address: str, query: str = "") -> Batch:
        """Check a request, and prepare its batch.

        `address` is the path of the run's components over REST and `query` a query, for the addresses of pictures.

        Raises:
            InputError, NotFoundError, StateError: no part of the request can be fulfilled.
            GoneError: the frames are no longer in memory, and no recording of the run is kept.
        """
        request = request.check()
        on_top = request.images.framing.plane == "top"
        # Of the entries that follow the verdict, only heights decide what a picture shows.
        finished = self.explained(run) if on_top else self.get(run)
        calculator, detail = finished.view_calculator, finished.detail
        resolution = float(np.mean([c.px_per_mm for c in finished.cameras]))
        components = request.parts(finished.board_type, resolution)
        facts, slots = finished.frame_facts, finished.slots
        result = with_heights(finished.result, self.heights(run) or {}) if on_top else finished.lean
        files = self._files(run, slots)
        if components:
            # A request that no component can fulfil is refused here, before the first byte.
            part = smallest(components)
            if request.hdr:
                with suppress(NotFoundError):  # one that no frame shows does not count
                    self.merged.pictures(run, request.of_merge(part))
            else:
                board = finished.board_type, result
                choose_all(calculator, [part], board, (slots, facts), request.images, lambda _: None)
        setup = BatchSetup(
            board_type=finished.board_type.model_copy(update={"components": ()}),
            stitch=finished.lean,
            cameras=finished.cameras,
            facts=facts,
            usable={key: slot for key, slot in slots.items() if not files or key in files},
            files=files,
            wanted=request.images,
            format=request.format,
            container=request.container,
            modified_s=int(datetime.fromisoformat(detail.finished or detail.started).timestamp()),
            address="" if request.region else address,
            query=query,
        )

        def tables() -> Mapping[str, Mapping[str, Any]]:
            of_top = ("heights_mm", "height_sigma_mm") if on_top else ()
            return {**tables_of(self.explained(run)), **{key: result.quality.get(key, {}) for key in of_top}}

        head = _head(self.published(detail), request, len(components), resolution)
        return Batch(run, request, components, setup, head, tables)

    def cut(self, batch: Batch, part: BatchPart) -> tuple[CutPart, BatchPart | None]:
        """Have a part cut. Return its members, and what remains of it.

        Raises:
            GoneError: the frames are no longer in memory.
            DeviceError: no worker cut the part in time.
        """
        if batch.request.hdr:
            return self._merge(batch, part.components[0]), None
        setup, tables = batch.prepared
        addresses = {c.address for c in part.components}
        quality = {key: {a: figures[a] for a in addresses & figures.keys()} for key, figures in tables.items()}
        recorded = bool(batch.setup.files)
        job = BatchJob(batch.run, 0, 0, setup, part.components, quality, part.image, recorded)
        name = f"{part.components[0].address} of a batch"
        if recorded:
            found = self.render(job, name)
        else:
            with self.lease(batch.run, "batch of pictures") as bay:
                found = self.render(replace(job, bay=bay.number, generation=bay.generation), name)
        return found, None if found.rest is None else BatchPart(part.components[found.rest[0] :], found.rest[1])

    def _files(self, run: str, slots: Mapping[FrameKey, int]) -> dict[FrameKey, Path]:
        """Return the files of frames in the run's recording; none if the frames are in memory."""
        try:
            with self.lease(run, "batch of pictures"):
                return {}
        except GoneError:
            files = recorded_files(self.recorded, run, slots)
            if not files:
                raise
            return files

    def _merge(self, batch: Batch, part: Component) -> CutPart:
        """Have the merged picture of one component made."""
        request, wanted = batch.request, batch.request.of_merge(part)
        folder = folder_of(part, region=request.region is not None)
        try:
            choice = self.merged.pictures(batch.run, wanted)[-1]
            form: MergedFormat = "npy" if request.format == "raw" else cast("MergedFormat", request.format)
            content = self.merged.image(batch.run, wanted, None, form)
        except (InputError, NotFoundError) as error:
            return CutPart(batch.pack(views_member(folder, refusal_entry(part, error))), 0, 1, None)
        suffix, media = MEDIA[request.format]
        if request.format == "raw":
            content = content[-4 * choice.view.width * choice.view.height :]
        file = f"{folder}/merged.{suffix}"
        entry = {"address": part.address, "views": [{"file": file, **merged_entry(choice)}]}
        return CutPart(batch.pack(views_member(folder, entry), Member(file, media, content)), 1, 0, None)


def merged_entry(choice: MergedChoice) -> dict[str, Any]:
    """Return the figures and matrices of a merged picture, by the names that REST uses."""
    view = choice.view
    return {
        "merged": [(f.view.camera, f.view.row) for f in choice.frames],
        "exposures": choice.exposures,
        "lights": list(dict.fromkeys(f.taken.light for f in choice.frames if f.taken.light is not None)),
        "width_px": view.width,
        "height_px": view.height,
        "px_per_mm": view.px_per_mm,
        "plane_height_mm": choice.plane_height_mm,
        "crop_from_cad": view.crop_from_cad.matrix.tolist(),
        "cad_from_crop": view.cad_from_crop.matrix.tolist(),
    }


def _head(detail: RunDetail, request: BatchRequest, components: int, px_per_mm: float) -> Member:
    """Return the first file: the run, and what was asked of it."""
    of_run = ("board_type", "board_id", "job_id", "state", "verdict", "started")
    document = {
        "run": detail.id,
        **{key: getattr(detail, key) for key in of_run},
        "components": components,
        "cameras_px_per_mm": px_per_mm,
        **{key: getattr(request, key) for key in ("format", "container", "hdr", "region", "within")},
        "parameters": request.images.options(),
        "version": __version__,
    }
    known = {key: value for key, value in document.items() if value is not None}
    return Member("run.json", "application/json", to_json(known))
