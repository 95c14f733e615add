"""Pixels of a run, for callers in any thread: copies of frames, and temporary images.

The memory of the ring may be given to the next board at any time. Therefore every access holds a lease while it reads
pixels. Of a run that is no longer in memory, frames are read from its recording, if one is kept.
"""

from __future__ import annotations

import itertools
import math
import threading
import time
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from contextlib import contextmanager
from pathlib import Path
from typing import Any, NamedTuple

from numpy.typing import NDArray

from vaoi_station.acquisition.ring import Ring
from vaoi_station.errors import DeviceError, GoneError, NotFoundError, StateError
from vaoi_station.files.images import read_kept_image
from vaoi_station.model import FrameRecord
from vaoi_station.rendering import ChosenImages, ChosenView, ImageRequest, Measures, View, measure
from vaoi_station.runs.archive import component_views
from vaoi_station.runs.archive.finished_runs import Archive, FinishedRun
from vaoi_station.runs.control.core import Core
from vaoi_station.runs.run.inbox import Inbox
from vaoi_station.runs.run.memory import OWN, Bay, Lease
from vaoi_station.runs.states.schemas import ImageFormat, RunDetail
from vaoi_station.runs.states.tables import FINISHED
from vaoi_station.runs.workers.jobs import PictureJob, Reply
from vaoi_station.runs.workers.picture_jobs import RenderJob, TileJob
from vaoi_station.runs.workers.run_stitcher import Workers
from vaoi_station.runs.workers.worker import perform_with_frames

SEATS = 2
"""Largest number of pictures that the station process renders at a time."""
SEAT_WAIT_S = 0.1
"""Longest wait for a seat; then a worker makes the picture."""
LARGEST_PX = 1_000_000
"""Largest number of pixels of a picture that the station process renders: some 25 × 25 mm at 40 px/mm, in 10 ms.

While the limit was 400,000 px, the largest components of a board, which are one in a hundred, waited 40 ms for a worker
that measured heights of the board before.
"""
RENDER_LIMIT_S = 60.0
"""Longest wait of a caller for a picture that a worker makes."""
FETCHING_S = 1.0
"""Time for which a caller that has fetched a picture, frame or tile is likely to fetch the next one."""


class ViewRequest(NamedTuple):
    """The request for one temporary image: the component's address, the index k of the image, and how it is chosen."""

    ref: str
    k: int
    images: ImageRequest


class FrameAccess:
    """Reads frames and temporary images of runs; each access takes a lease. Methods may be called from any thread."""

    def __init__(self, inbox: Inbox, core: Core, ring: Ring, archive: Archive, workers: Workers) -> None:
        self._inbox, self._core, self._ring = inbox, core, ring
        self._archive, self._workers = archive, workers
        self._seats = threading.BoundedSemaphore(SEATS)
        self.recorded: Callable[[str, int, int], Path | None] = lambda _run, _camera, _row: None
        """Returns the file of a frame (run, camera, row) in the run's recording; None if there is no recording.

        Raises GoneError if the recording does not have the frame.
        """
        self.heights: Callable[[str], Mapping[str, tuple[float, float]] | None] = lambda _run: None
        """Returns the measured heights of a run by address, with their standard deviations, mm."""
        self._uses, self._fetched_s = itertools.count(1), -math.inf

    def render(self, job: PictureJob, name: str) -> Any:
        """Have a worker perform a job, and return the value of its reply; `DeviceError` after `RENDER_LIMIT_S`."""
        # The reply goes from the pool's thread to this one: it need not wait in the inbox behind messages about frames.
        answer: Future[Reply] = Future()
        self._workers.submit(job, answer.set_result)
        try:
            reply = answer.result(job.awaited_s or RENDER_LIMIT_S)
        except TimeoutError:
            raise DeviceError(
                f"No worker rendered image {name} within {job.awaited_s or RENDER_LIMIT_S:.0f} s.",
                action="Check the state of the workers.",
            ) from None
        if reply.error is not None:
            raise reply.error
        return reply.value

    def render_here(self, job: RenderJob | TileJob) -> bytes | None:
        """Return the small picture of a job, rendered from the ring in this thread; None if a worker has to render it.

        By a worker, a picture of one to ten milliseconds would take a lease, the queues and two pipes besides, and the
        wait for what all workers have under way. OpenCV releases the GIL, so that the coordinator's thread goes on.
        Workers render what is large, what no caller waits for, and HDR. No lease is needed: the generation of the bay
        is checked after the pixels were read, as in workers.
        """
        if isinstance(job, RenderJob):
            small, size = job.file is None and job.minus is None, job.view.width * job.view.height
        else:
            small, size = job.format is not None and not job.spec.hdr, job.spec.width * job.spec.height
        if not small or size > LARGEST_PX or not self._seats.acquire(timeout=SEAT_WAIT_S):
            return None
        try:
            picture: bytes = perform_with_frames(job, self._ring)
            return picture
        except GoneError:
            return None  # the frame may be in a recording, which the caller looks up
        finally:
            self._seats.release()

    def frame(
        self, detail: RunDetail, camera: int, row: int, allow_incomplete: bool
    ) -> tuple[NDArray[Any], FrameRecord]:
        """Copy one frame out of the ring or the recording, with its record; see `StationCoordinator.frame`."""
        self.note_fetch()
        record = frame_record(detail, camera, row)
        where = f"Frame (camera {camera}, row {row}) of run {detail.id}"
        component_views.refuse_unusable(record, where, allow_incomplete)
        assert record.slot is not None, "only missing frames have no slot"
        try:
            with self.lease(detail.id, f"frame {camera}/{row}") as bay:
                return self._ring.snapshot(record.slot, bay.generation), record
        except GoneError:
            if (file := self.recorded(detail.id, camera, row)) is None:
                raise
        return read_kept_image(file), record

    def image(self, detail: RunDetail, wanted: ViewRequest, format: ImageFormat) -> bytes:
        """Render one temporary image, in a worker or in this thread, and return it as an encoded file."""
        self.note_fetch()
        finished = self._finished(detail.id, wanted.images)
        name = f"{wanted.ref}/{wanted.k}"
        measure, heights = self._measured_by(detail), self._heights(detail.id, wanted.images)
        choice = component_views.image_of_component(finished, wanted.ref, wanted.k, wanted.images, measure, heights)
        if detail.bay is not None and detail.generation is not None and detail.frames_available:
            own = self.render_here(_job(finished, choice, format, (detail.bay, detail.generation)))
            if own is not None:
                return own
        try:
            with self.lease(detail.id, f"image {name}") as bay:
                job = _job(finished, choice, format, (bay.number, bay.generation))
                picture: bytes = self.render(job, name)
                return picture
        except GoneError:
            # A difference needs both of its frames.
            needed = [s.view for s in (choice, choice.minus) if s is not None]
            files = [self.recorded(detail.id, view.camera, view.row) for view in needed]
            if None in files:
                raise
        recorded: bytes = self.render(_job(finished, choice, format, (0, 0), files), name)
        return recorded

    def images(self, detail: RunDetail, ref: str, wanted: ImageRequest) -> ChosenImages:
        """Choose the images of a component; GoneError if that depends on pixels that are no longer available."""
        measure = self._measured_by(detail, optional=not wanted.needs_pixels)
        heights = self._heights(detail.id, wanted)
        finished = self._finished(detail.id, wanted)
        return component_views.images_of_component(finished, ref, wanted, measure, heights)

    def _finished(self, run: str, wanted: ImageRequest) -> FinishedRun:
        # Heights of bodies come a moment after the result.
        return self._archive.explained(run) if wanted.framing.plane == "top" else self._archive.get(run)

    def _heights(self, run: str, wanted: ImageRequest) -> Mapping[str, tuple[float, float]] | None:
        return self.heights(run) if wanted.framing.plane == "top" else None

    def _measured_by(self, detail: RunDetail, optional: bool = False) -> Callable[[View], Measures | None]:
        def measured(view: View) -> Measures | None:
            try:
                return measure(view, self.frame(detail, view.camera, view.row, False)[0])
            except GoneError:
                if optional:
                    return None
                raise

        return measured

    def tile(self, job: TileJob) -> bytes | None:
        """Render a tile in this thread; None if a worker has to, as while a board is filmed or stitched.

        Callers of tiles come in numbers. Rendered beside the workers, tiles of eight callers delayed matrices by 0.1 s.
        """
        return None if self.busy() else self.render_here(job)

    def bay_of(self, run: str) -> Bay:
        """Return the bay of a run, without a lease. Raise GoneError if the frames are no longer in memory."""
        with self.lease(run, "look-up of its memory") as bay:
            return bay

    def busy(self) -> bool:
        """Return whether a board is being filmed or stitched."""
        return bool(self._core.active)

    def note_fetch(self) -> None:
        """Note that a caller fetches a picture, a frame or a tile now."""
        self._fetched_s = time.monotonic()

    def in_use(self) -> bool:
        """Return whether a board is being filmed or stitched, or a caller fetches pictures, frames or tiles."""
        return self.busy() or time.monotonic() - self._fetched_s < FETCHING_S

    def copier(self, bay: Bay) -> Callable[[int], NDArray[Any]]:
        """Return a function that takes the number of a slot in a leased bay, and returns a copy of the frame in it."""
        return lambda slot: self._ring.snapshot(slot, bay.generation)

    @contextmanager
    def lease(self, run: str, purpose: str) -> Iterator[Bay]:
        """Keep a run's frames in memory in a `with` block. Raise GoneError if they are no longer in memory."""
        holder = f"{OWN}{next(self._uses)}"
        bay, _ = self.take_lease(run, holder, purpose)
        try:
            yield bay
        finally:
            self._inbox.post(self._core.end_lease, run, holder)

    def take_lease(self, run: str, holder: str, purpose: str) -> tuple[Bay, Lease]:
        """Begin or renew a lease; return the run's bay and the lease. BusyError if the run has too many holders."""

        def take() -> tuple[Bay, Lease]:
            memory = self._core.memory
            if not memory.has(run) and run not in self._core.active:
                self._archive.get(run)  # This raises NotFoundError: a run that is unknown must not be reported as gone.
            return memory.bay(run), memory.lease(run, holder, purpose)

        return self._inbox.ask(take)


def _job(
    finished: FinishedRun,
    choice: ChosenView,
    format: ImageFormat,
    place: tuple[int, int],
    files: Sequence[Path | None] = (),
) -> RenderJob:
    """Make the job that renders an image from frames in a bay (number, generation), or from files of its frames."""
    record = finished.frame_records[choice.view.camera, choice.view.row]
    assert record.slot is not None, "views are of whole frames"
    minus = None if choice.minus is None else _job(finished, choice.minus, format, place, files[1:])
    file = files[0] if files else None
    run, view, ratio = finished.detail.id, choice.view, choice.ratio
    balance = choice.facts.white_balance
    return RenderJob(
        run, *place, record.slot, view, format, file=file, minus=minus, ratio=ratio, white_balance=balance
    )  # fmt: skip


def frame_record(detail: RunDetail, camera: int, row: int) -> FrameRecord:
    """Return the record of a frame; StateError if it may still arrive, NotFoundError if there is no such frame."""
    for frame in detail.frames:
        if (frame.camera, frame.row) == (camera, row):
            return frame
    if detail.state not in FINISHED and 0 <= camera < detail.cameras and row >= 0:
        raise StateError(f"Camera {camera}, row {row} of run {detail.id} has not arrived yet.", action="Retry.")
    raise NotFoundError(
        f"Run {detail.id} has {detail.cameras} cameras and {detail.rows} rows, numbered from 0; "
        f"there is no camera {camera}, row {row}.",
        action="Take camera and row from the frames in the document of the run.",
        code="no-such-frame",
    )
