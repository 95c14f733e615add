"""The mosaics of finished runs: plans that workers make once, and tiles that this process or workers render."""

from __future__ import annotations

import threading
from collections.abc import Callable, Hashable
from contextlib import AbstractContextManager, nullcontext
from dataclasses import replace
from pathlib import Path
from typing import Any, NamedTuple

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.errors import BusyError, InputError, StateError
from vaoi_station.files.images import encode_jpeg, encode_png
from vaoi_station.files.pyramids import TILE_PX, PyramidLayout, refuse_without_room, write_pyramid
from vaoi_station.frame_index import Box, FrameIndex
from vaoi_station.model.stitch_result import Heights, with_heights
from vaoi_station.mosaic import MosaicGrid, MosaicPlan, TakenFrame, TileRenderer, choose_frames, distinct_exposures_us
from vaoi_station.mosaic.grid import Region
from vaoi_station.mosaic.tile_specs import TileSpec
from vaoi_station.mosaic.tiles import NODATA
from vaoi_station.photometry import FlatFields
from vaoi_station.photometry.flat_fields import changed_ns
from vaoi_station.runs.archive.finished_runs import Archive, FinishedRun
from vaoi_station.runs.merging.merged_pictures import Lease, Render
from vaoi_station.runs.mosaics.board_checks import BoardChecks
from vaoi_station.runs.mosaics.opened_mosaics import OpenedMosaic, OpenedMosaics, Overview, PictureName, PlannedMosaic
from vaoi_station.runs.mosaics.overlays import overlay_of
from vaoi_station.runs.run.memory import Bay
from vaoi_station.runs.states.schemas import RunOverlay
from vaoi_station.runs.workers.jobs import PictureJob, Priority
from vaoi_station.runs.workers.picture_jobs import PlanJob, TileJob

KnownHeights = Callable[[str], Heights | None]
"""Function that returns the measured heights of a run; None while there are none."""
Hastened = Callable[[type[PictureJob], str], AbstractContextManager[None]]
"""Function that has spare-time jobs of a kind and a run done as if a caller had submitted them, in a `with` block."""
MOST_DOWNLOAD_PX = 300_000_000
"""Largest number of pixels of a file that is sent; a board of 400 × 410 mm at 40 px/mm has 262 million."""
LARGE_PX = 64_000_000
"""Number of pixels from which on one file is made at a time: the largest takes 1.9 GB of the disk with HDR."""
LEFT_FREE = 1_000_000_000
"""Least number of bytes that a file leaves free on the disk, which recordings may need meanwhile."""


class Download(NamedTuple):
    """What is sent as one file."""

    region: Region | None
    """Two opposite corners in CAD coordinates; None for the whole board."""
    px_per_mm: float | None
    """Resolution; None for that of the cameras."""


class Mosaics:
    """Renders mosaics of runs. Methods may be called from any thread."""

    def __init__(
        self,
        archive: Archive,
        lease: Lease,
        render: Render,
        flat_fields: Path | None = None,
        heights: KnownHeights = lambda _run: None,
        hastened: Hastened = lambda _kind, _run: nullcontext(),
        fetched: Callable[[], None] = lambda: None,
        own: Callable[[TileJob], bytes | None] = lambda _job: None,
    ) -> None:
        """Store the parts.

        `fetched` notes that a caller fetches a tile, and is likely to fetch the next one. `own` renders a tile in this
        process, without a lease; None if a worker has to.
        """
        self._archive, self._lease, self._render, self._hastened = archive, lease, render, hastened
        self._fetched, self._own = fetched, own
        self._flat_fields, self._heights = flat_fields, heights
        self.board_checks = BoardChecks(archive, lease, render)
        """Board types laid over these runs."""
        self._large, self._opened = threading.Lock(), OpenedMosaics()

    def names(self, run: str) -> tuple[PictureName, ...]:
        """Return the mosaics of a run: of every light, and of every exposure and HDR where exposures differ."""
        frames = _taken(self._archive.get(run))
        found = [PictureName()]
        lights: tuple[str | None, ...] = tuple(dict.fromkeys(f.light for f in frames))
        for light in lights if len(lights) > 1 else (None,):
            lit = [f for f in frames if light is None or f.light == light]
            found += [PictureName(light)] if light is not None else []
            exposures = distinct_exposures_us(lit)
            if len(exposures) > 1:
                found += [PictureName(light, exposure) for exposure in exposures] + [PictureName(light, hdr=True)]
        return tuple(found)

    def grid(self, run: str, name: PictureName, download: Download | None = None) -> MosaicGrid:
        """Return the largest grid of a mosaic; it is computed without frames.

        Raises:
            InputError: the run has no such light or exposure, or what is to be sent is too large or off the board.
            StateError: the run has no CAD mapping.
            NotFoundError: the run is unknown, or ended without a result.
        """
        finished = self._archive.get(run)
        if download is None and (opened := self._opened.get(self._key(run, name))) is not None:
            return opened.grid
        choose_frames(_taken(finished), light=name.light, exposure_us=name.exposure_us, hdr=name.hdr)
        resolution = FrameIndex.of_result(finished.lean, finished.cameras).px_per_mm
        if download is None:
            return MosaicGrid.of_board(finished.board_type, resolution)
        return MosaicGrid.of_board(
            finished.board_type, download.px_per_mm or resolution, download.region, MOST_DOWNLOAD_PX
        )

    def overlay(self, run: str) -> RunOverlay:
        """Return what is drawn over the mosaics of a run; raises the errors of `overlay_of`."""
        return overlay_of(self._archive.explained(run))

    def tile(self, run: str, name: PictureName, reduction: int, box: Box, format: str) -> bytes:
        """Return a part of a mosaic that is reduced by a factor, as `jpg` or `png`.

        It is cut from the overview, which a worker makes with the plan. What the overview lacks is rendered.

        Raises:
            GoneError: the frames of the run are no longer in memory.
            InputError: the flat fields do not fit the run.
        """
        self._fetched()
        finished, opened = self._archive.get(run), self._open(run, name, asked=True)
        plan, overview = self._planned(finished, name, opened)
        if overview is not None and overview.reduction <= reduction and finished.detail.frames_available:
            cut = overview.cut(reduction, box)
            return encode_jpeg(cut) if format == "jpg" else encode_png(cut)
        job = _tile_job(finished, opened.renderer(plan, reduction).spec(box), plan, format)
        detail = finished.detail
        if detail.bay is not None and detail.generation is not None and detail.frames_available:
            own = self._own(replace(job, bay=detail.bay, generation=detail.generation))
            if own is not None:
                return own
        content: bytes = self._rendered(job)
        return content

    def small(self, run: str, most_px: int, lease: Lease) -> tuple[NDArray[Any], int]:
        """Have a worker plan the mosaic of a run, in a job of spare time; return a small picture of the board.

        Returns its pixels, 0 where no frame shows the board, and the factor by which it is reduced. `lease` yields the
        bay of the run before the job.
        """
        finished, opened = self._archive.get(run), self._open(run, PictureName(), asked=False)
        reduction = 1
        while opened.grid.width * opened.grid.height > most_px * reduction**2:
            reduction *= 2
        planned = opened.planned or self._made(finished, PictureName(), opened, lease, Priority.OVERVIEW)
        overview = planned.overview
        assert overview is not None, "it is not HDR"
        reduction = max(reduction, overview.reduction)
        picture = overview.level(reduction)
        if picture is None:
            raise StateError(f"No frame of run {run} shows the board.", code="not-covered")
        return picture, reduction

    def write(self, run: str, name: PictureName, download: Download, path: Path) -> None:
        """Write a mosaic as a pyramidal TIFF, as `vaoi mosaic` does, tile by tile.

        Raises:
            BusyError: another file of more than `LARGE_PX` is being made.
            DeviceError: the disk has no room for it.
            GoneError: the frames are no longer in memory, or were displaced by those of a board meanwhile.
            InputError: it is too large, off the board, or no frame shows it.
        """
        # Refused first what is refused without frames: a plan that cannot be made would displace another one.
        grid = self.grid(run, name, download)
        pixels = grid.width * grid.height
        large = self._large if pixels > LARGE_PX else threading.Lock()
        if not large.acquire(blocking=False):
            raise BusyError(
                f"another file of a whole board is being made; of more than {LARGE_PX / 1e6:.0f} megapixels, and this "
                f"one has {pixels / 1e6:.0f}, there is one at a time.",
                action="Try again later, or ask for a lower resolution or a region.",
            )
        try:
            self._write(run, name, grid, path)
        finally:
            large.release()

    def _write(self, run: str, name: PictureName, grid: MosaicGrid, path: Path) -> None:
        finished, opened = self._archive.get(run), self._open(run, name, asked=True)
        plan = self._planned(finished, name, opened).plan
        renderer = TileRenderer(plan, opened.projector, grid)

        def rendered(x: int, y: int) -> NDArray[Any] | None:
            box = x * TILE_PX, y * TILE_PX, min((x + 1) * TILE_PX, grid.width), min((y + 1) * TILE_PX, grid.height)
            pixels: NDArray[Any] | None = self._rendered(_tile_job(finished, renderer.spec(box), plan, None))
            return pixels

        sample: NDArray[Any] | None = None
        # The first tile with pixels says which type and how many colours the frames have.
        for x, y in np.ndindex(-(-grid.width // TILE_PX), -(-grid.height // TILE_PX)):
            sample = rendered(x, y)
            if sample is not None:
                break
        if sample is None:
            raise InputError(
                f"no frame of run {run} shows any of this region.", action="Choose another region.", code="not-covered"
            )
        colour = sample.ndim == 3
        nodata = "nan" if plan.hdr else str(NODATA)
        layout = PyramidLayout(
            grid.width, grid.height, sample.dtype, 3 if colour else 1, nodata, grid.px_per_mm, f"run {run}, {name}"
        )
        refuse_without_room(path, layout, LEFT_FREE)

        def tile(x: int, y: int) -> NDArray[Any]:
            whole = np.full(layout.tile_shape, np.nan if plan.hdr else NODATA, layout.dtype)
            part = rendered(x, y)
            if part is not None:
                whole[: part.shape[0], : part.shape[1]] = cv2.cvtColor(part, cv2.COLOR_BGR2RGB) if colour else part
            return whole

        write_pyramid(path, layout, tile)

    def _rendered(self, job: TileJob) -> Any:
        """Have a worker render a tile, and return the reply's value."""
        with self._lease(job.run, "tile of a mosaic") as bay:
            return self._render(replace(job, bay=bay.number, generation=bay.generation), "tile of the mosaic")

    def _key(self, run: str, name: PictureName) -> Hashable:
        """Return what a plan depends on besides the frames.

        Flat fields may be replaced while the run is in memory, and HDR lays bodies in the planes of their tops as soon
        as their heights are measured or known by links.
        """
        known = name.hdr and (self._heights(run) is not None, self._archive.get(run).complete)
        return run, name, changed_ns(self._flat_fields), known

    def _open(self, run: str, name: PictureName, *, asked: bool) -> OpenedMosaic:
        """Return a mosaic with all that its tiles are made with; raises the errors of `grid`."""
        key = self._key(run, name)
        opened = self._opened.get(key)
        if opened is None:
            finished, grid = self._archive.get(run), self.grid(run, name)
            opened = OpenedMosaic(grid, FrameIndex.of_result(finished.lean, finished.cameras))
        return self._opened.use(key, opened, asked=asked)

    def _planned(self, finished: FinishedRun, name: PictureName, opened: OpenedMosaic) -> PlannedMosaic:
        """Return plan and overview of a mosaic; a worker makes them if there are none.

        A plan that is made in spare time is then as urgent as one of a caller: it is nearer to its end than a new one.
        """
        if opened.planned is not None:
            return opened.planned
        with self._hastened(PlanJob, finished.detail.id):
            return self._made(finished, name, opened, self._lease, Priority.RENDER)

    def _made(
        self, finished: FinishedRun, name: PictureName, opened: OpenedMosaic, lease: Lease, priority: Priority
    ) -> PlannedMosaic:
        """Have a worker make plan and overview of a mosaic, or wait until they are there if others have them made."""
        # Each holds the frames by a lease of its own: those of a caller stay, those of spare time need not. The lease
        # comes first, because in spare time it waits for the line.
        with lease(finished.detail.id, "plan of a mosaic") as bay, opened.planning:
            if (planned := opened.planned) is None:
                planned = self._plan(finished, name, opened, bay, priority)
                self._opened.keep(opened, planned)
            return planned

    def _plan(
        self, finished: FinishedRun, name: PictureName, opened: OpenedMosaic, bay: Bay, priority: Priority
    ) -> PlannedMosaic:
        choice = choose_frames(_taken(finished), light=name.light, exposure_us=name.exposure_us, hdr=name.hdr)
        base = MosaicGrid.of_board(finished.board_type, opened.projector.px_per_mm, most_px=float("inf"))
        run, stitch = finished.detail.id, finished.lean
        if name.hdr:
            # The complete result has heights of its own, from its links.
            stitch = with_heights(finished.result, self._heights(run) or {})
        if self._flat_fields is not None and finished.head is not None:
            # Refused here, before a worker is asked.
            lights = [choice.light] if choice.light is not None else None
            FlatFields.peek(self._flat_fields).check(finished.head.cameras, lights)
        job = PlanJob(
            run, bay.number, bay.generation, finished.slots, choice, finished.cameras, stitch, finished.board_type,
            base, opened.grid, self._flat_fields, priority=priority,
        )  # fmt: skip
        plan, reduction, picture = self._render(job, "plan of the mosaic")
        return PlannedMosaic(plan, None if choice.hdr else Overview(picture, reduction))


def _tile_job(finished: FinishedRun, spec: TileSpec, plan: MosaicPlan, format: str | None) -> TileJob:
    """Return the job that renders a tile as `jpg`, `png` or pixels (None), without the place of the run in memory."""
    needed = {(p.camera, p.row): finished.slots[p.camera, p.row] for p in spec.parts}
    return TileJob(finished.detail.id, 0, 0, needed, spec, plan.tone, format)


def _taken(finished: FinishedRun) -> tuple[TakenFrame, ...]:
    """Return the usable frames of a run with what they were taken with."""
    head = finished.head

    def exposure(camera: int, row: int, measured: float | None) -> float:
        if measured is not None:
            return measured
        return head.exposure_us(camera, row) if head is not None and row < head.rows else 1.0

    return tuple(
        TakenFrame(f.camera, f.row, exposure(f.camera, f.row, f.exposure_us), f.gain or 1.0, f.light or None)
        for f in finished.detail.frames
        if f.usable
    )
