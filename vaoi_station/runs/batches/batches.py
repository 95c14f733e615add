"""Batches of a station: what a request needs is prepared once; each part is cut by a worker under a lease of its own.

The lease lasts for one part, so that a caller who reads slowly does not keep memory from the next boards. If the frames
are evicted meanwhile, the batch ends with a document that says so.
"""

from __future__ import annotations

import pickle
from collections.abc import Callable, Mapping
from contextlib import AbstractContextManager, suppress
from dataclasses import dataclass, replace
from datetime import datetime
from functools import cached_property
from pathlib import Path
from typing import Any, NamedTuple, cast

import numpy as np
from pydantic_core import to_json

from vaoi_station.errors import GoneError, InputError, NotFoundError, VaoiError
from vaoi_station.hdr.encoding import MergedFormat
from vaoi_station.model import Component
from vaoi_station.model.stitch_result import Heights, with_heights
from vaoi_station.rendering import choose_all
from vaoi_station.runs.archive.component_views import frame_facts, tables_of
from vaoi_station.runs.archive.finished_runs import FinishedRun
from vaoi_station.runs.batches.batch_job import (
    MEDIA,
    BatchJob,
    BatchSetup,
    CutPart,
    Resume,
    folder_of,
    refusal,
    refusal_entry,
    views_member,
)
from vaoi_station.runs.batches.batch_request import BatchRequest, smallest
from vaoi_station.runs.batches.containers import Member, Packed, pack
from vaoi_station.runs.merging.merged_pictures import MergedAccess, MergedChoice, MergeRequest
from vaoi_station.runs.run.memory import Bay
from vaoi_station.runs.states.schemas import RunDetail
from vaoi_station.stitching.matching.evidence import FrameKey
from vaoi_station.version import __version__

FIRST_PARTS = (4, 8, 16, 32)
"""Numbers of components of the first parts; they are small, so that the first picture comes early."""
PART_COMPONENTS = 64
"""Number of components of all later parts; a part ends before them when it is large."""


@dataclass(frozen=True)
class BatchPart:
    """Components that are cut next, and the image with which the first one begins."""

    components: tuple[Component, ...]
    image: int = 0


class Prepared(NamedTuple):
    """What all parts of a batch need."""

    setup: bytes
    """Pickled `BatchSetup`."""
    quality: Mapping[str, Mapping[str, Any]]
    """Entries of the result's quality that have one value per component."""


@dataclass(frozen=True)
class Batch:
    """A batch that can be cut: the components in their order, and what all parts share."""

    run: str
    request: BatchRequest
    components: tuple[Component, ...]
    prepare: Callable[[], Prepared]
    """Function that makes what all parts need; the head is sent before it is called."""
    recorded: bool
    """Whether frames are read from the run's recording."""
    modified_s: int
    head: Member
    """The first file: what the batch is of."""

    @cached_property
    def prepared(self) -> Prepared:
        """What all parts need."""
        return self.prepare()

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

    def pack(self, member: Member) -> Packed:
        """Return a file as bytes of the batch's container."""
        return pack(self.request.container, [member], self.modified_s)

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
    """Function that returns the document of a run as callers see it: its identity may lower the verdict."""

    def open(self, run: str, request: BatchRequest, address: str, query: str = "") -> Batch:
        """Check a request, and prepare its batch.

        Args:
            run: id of the run.
            request: the request.
            address: path of the run's components over REST, for the addresses of single pictures.
            query: query of these addresses.

        Raises:
            InputError, NotFoundError, StateError: no part of the request can be fulfilled.
            GoneError: the frames are no longer in memory, and no recording of the run is kept.
        """
        request = request.check()
        finished = self.get(run)
        calculator = finished.view_calculator
        resolution = float(np.mean([c.px_per_mm for c in finished.cameras]))
        components = request.parts(finished.board_type, resolution)
        facts, slots = frame_facts(finished), _slots(finished)
        on_top = request.images.framing.plane == "top"
        result = (
            with_heights(finished.result, self.heights(run) or {}) if on_top else finished.stitch or finished.result
        )
        files = self._files(run, slots)
        if request.hdr:
            self._try_merging(run, request, components)
        elif components:
            # A light or a direction that the run does not have is refused here, before the first byte.
            part = smallest(components)
            choose_all(
                calculator, [part], (finished.board_type, result), (slots, facts), request.images, lambda _: None
            )
        detail = finished.detail
        modified_s = int(datetime.fromisoformat(detail.finished or detail.started).timestamp())
        setup = BatchSetup(
            board_type=finished.board_type.model_copy(update={"components": ()}),
            stitch=finished.stitch or finished.result,
            cameras=finished.cameras,
            facts=facts,
            usable={key: slot for key, slot in slots.items() if not files or key in files},
            files=files,
            wanted=request.images,
            format=request.format,
            container=request.container,
            modified_s=modified_s,
            address="" if request.region else address,
            query=query,
        )

        def prepare() -> Prepared:
            quality = tables_of(finished)
            if on_top:
                quality = {**quality, **{key: result.quality[key] for key in ("heights_mm", "height_sigma_mm")}}
            return Prepared(pickle.dumps(setup, pickle.HIGHEST_PROTOCOL), quality)

        head = _head(self.published(finished.detail), request, len(components), resolution)
        return Batch(run, request, components, prepare, bool(files), modified_s, head)

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
        quality = {
            key: {address: figures[address] for address in addresses & figures.keys()}
            for key, figures in tables.items()
        }
        job = BatchJob(batch.run, 0, 0, setup, part.components, quality, Resume(0, part.image), batch.recorded)
        name = f"{part.components[0].address} of a batch"
        if batch.recorded:
            found = self.render(job, name)
        else:
            with self.lease(batch.run, "batch of pictures") as bay:
                found = self.render(replace(job, bay=bay.number, generation=bay.generation), name)
        rest = found.rest
        return found, None if rest is None else BatchPart(part.components[rest.component :], rest.image)

    def _files(self, run: str, slots: Mapping[FrameKey, int]) -> dict[FrameKey, Path]:
        """Return the files of frames in the run's recording; none if the frames are in memory."""
        try:
            with self.lease(run, "batch of pictures"):
                return {}
        except GoneError:
            files = {}
            for key in slots:
                try:
                    file = self.recorded(run, *key)
                except GoneError:  # the recording has only complete, proven frames
                    continue
                if file is not None:
                    files[key] = file
            if not files:
                raise
            return files

    def _try_merging(self, run: str, request: BatchRequest, components: tuple[Component, ...]) -> None:
        """Refuse a request that no component can fulfil; one that no frame shows does not count."""
        if components:
            with suppress(NotFoundError):
                self.merged.pictures(run, _merge_request(request, smallest(components)))

    def _merge(self, batch: Batch, part: Component) -> CutPart:
        """Have the merged picture of one component made."""
        folder, request = folder_of(part, region=batch.request.region is not None), batch.request
        wanted = _merge_request(request, part)
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
        members = [views_member(folder, entry), Member(file, media, content)]
        return CutPart(pack(request.container, members, batch.modified_s), 1, 0, None)


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


def _merge_request(request: BatchRequest, part: Component) -> MergeRequest:
    light, resolution = request.images.choice.light, request.images.framing.px_per_mm
    asked = request.images.options().get("min_coverage")
    if request.region is not None:
        return MergeRequest(None, request.region, light, resolution, asked)
    return MergeRequest(part.address, None, light, resolution, asked)


def _slots(finished: FinishedRun) -> dict[FrameKey, int]:
    return {(f.camera, f.row): f.slot for f in finished.detail.frames if f.usable and f.slot is not None}


def _head(detail: RunDetail, request: BatchRequest, components: int, px_per_mm: float) -> Member:
    """Return the first file: the run, and what was asked of it."""
    document = {
        "run": detail.id,
        "board_type": detail.board_type,
        "board_id": detail.board_id,
        "job_id": detail.job_id,
        "state": detail.state,
        "verdict": detail.verdict,
        "started": detail.started,
        "components": components,
        "cameras_px_per_mm": px_per_mm,
        "format": request.format,
        "container": request.container,
        "hdr": request.hdr,
        "region": request.region,
        "within": request.within,
        "parameters": request.images.options(),
        "version": __version__,
    }
    known = {key: value for key, value in document.items() if value is not None}
    return Member("run.json", "application/json", to_json(known))
