"""The coordinator: what any thread may ask of the station answered by one thread.

Questions about what is going on go through the inbox to `Core`; finished runs are read from the
archive by whoever asks. Pixels are copied or rendered under a lease.
"""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable, Iterator
from concurrent.futures import Future
from contextlib import contextmanager
from dataclasses import replace
from typing import Any

from numpy.typing import NDArray

from vaoi_station.acquisition.ring.ring import Ring
from vaoi_station.config import MethodName
from vaoi_station.errors import DeviceError, InputError, NotFoundError, StateError
from vaoi_station.model import BoardType, FrameRecord, Stitch
from vaoi_station.rendering import View
from vaoi_station.runs.archive import component_views as gallery
from vaoi_station.runs.control.core import Core, Parts
from vaoi_station.runs.control.inbox import Inbox
from vaoi_station.runs.control.inbox_events import InboxEvents
from vaoi_station.runs.control.picture_requests import PictureRequests
from vaoi_station.runs.control.station_events import StationEvents
from vaoi_station.runs.control.status import snapshot_of
from vaoi_station.runs.control.teaching import Teaching, listed
from vaoi_station.runs.host.gc_policy import GcPolicy
from vaoi_station.runs.run.leases import OWN, Lease
from vaoi_station.runs.run.memory import Bay
from vaoi_station.runs.run.order import Order
from vaoi_station.runs.run.reference_store import ReferenceShelf
from vaoi_station.runs.run.run_views import detail_of
from vaoi_station.runs.states.calibration_schemas import CalibrationStatus
from vaoi_station.runs.states.schemas import (
    BoardTypeSummary,
    ComponentSummary,
    EventRecord,
    ImageFormat,
    LeaseStatus,
    ProcessStatus,
    ReferenceStatus,
    RunDetail,
    RunSummary,
    StationSnapshot,
    StitchingMethod,
    Timeline,
)
from vaoi_station.runs.states.tables import FINISHED
from vaoi_station.runs.workers.jobs import RenderJob
from vaoi_station.store import BoardTypeDirectory

ARM_LIMIT_S = 30.0
"""Cameras that have not taken their memory by then do not answer."""
MOST_RUNS_LISTED = 1000

MakeOrder = Callable[[BoardType, "str | None", "str | None"], Order]


class StationCoordinator:
    """Started and stopped by `station.Station`."""

    def __init__(
        self,
        parts: Parts,
        ring: Ring,
        board_types: BoardTypeDirectory,
        make_order: MakeOrder,
        shelf: ReferenceShelf,
        processes: Callable[[], tuple[ProcessStatus, ...]],
        alive: Callable[[], None] = lambda: None,
    ) -> None:
        self._parts, self._ring, self._board_types = parts, ring, board_types
        self._make_order, self._processes, self._alive = make_order, processes, alive
        self._inbox = Inbox(self._tick)
        self._gc_policy = GcPolicy()
        self._core = Core(parts)
        self._pictures = PictureRequests(parts.workers)
        self.process_events: StationEvents = InboxEvents(self._inbox, self._core, self._pictures)
        """Receives what the acquisition process and the workers report."""
        self._uses = itertools.count(1)
        self._teaching = threading.Lock()
        self._references = Teaching(shelf, parts.config.method)

    # --- its life

    def start(self) -> None:
        """Begin to work."""
        self._gc_policy.start()
        self._inbox.start()

    def wind_down(self, timeout_s: float) -> None:
        """Take no more boards and let the runs under way come to their end, if they do so in time."""
        waiter: Future[None] = Future()
        try:
            self._inbox.wait(waiter, lambda: self._core.stop(waiter), timeout_s)
        except TimeoutError:
            return  # what is not done by then is told to be lost at the next start

    def close(self) -> None:
        """End the thread; nobody is left waiting."""
        self._inbox.close()
        self._gc_policy.stop()
        self._parts.archive.close()
        self._parts.events.close()

    # --- the station

    def snapshot(self) -> StationSnapshot:
        """State, health, memory and versions at this moment."""
        return self._inbox.ask(self._snapshot)

    def arm(
        self,
        board_type: str,
        board_id: str | None = None,
        job_id: str | None = None,
        runs: int | None = None,
        allow_lost_cameras: bool = False,
    ) -> StationSnapshot:
        """Film every board from now on, or so many runs."""
        if runs is not None and runs < 1:
            raise InputError.field("arm", "runs", runs, "at least 1, or absent")
        order = self._make_order(self._board_types.get(board_type), board_id, job_id)
        order = replace(order, despite_lost_cameras=allow_lost_cameras)
        waiter: Future[None] = Future()
        try:
            self._inbox.wait(waiter, lambda: self._core.arm(order, runs, waiter), ARM_LIMIT_S)
        except TimeoutError:
            self._inbox.post(self._core.disarm, Future())
            raise DeviceError(
                f"Cameras and controller were not ready within {ARM_LIMIT_S:.0f} s; the line was disarmed.",
                action="See the health of cameras and controller.",
                code="arming-failed",
            ) from None
        for note in order.notes:
            self._parts.events.add("trouble", note.message, code=note.code, action=note.action)
        return self.snapshot()

    def disarm(self) -> StationSnapshot:
        """Ignore the barrier."""
        waiter: Future[None] = Future()
        try:
            self._inbox.wait(waiter, lambda: self._core.disarm(waiter), ARM_LIMIT_S)
        except TimeoutError:
            raise DeviceError(
                f"The acquisition process did not disarm within {ARM_LIMIT_S:.0f} s.", code="disarming-failed"
            ) from None
        return self.snapshot()

    def events(self, after: int = 0, timeout_s: float = 0.0, limit: int = 1000) -> tuple[EventRecord, ...]:
        """Events numbered above `after`."""
        return self._parts.events.read(after, timeout_s, limit)

    # --- board types

    def board_types(self) -> tuple[BoardTypeSummary, ...]:
        """All board types, by name."""
        return tuple(listed(entry.path.stem, entry.board_type, entry.fault) for entry in self._board_types.list())

    def board_type(self, name: str) -> BoardType:
        """One board type."""
        return self._board_types.get(name)

    def put_board_type(self, board_type: BoardType) -> bool:
        """Teach a board type."""
        with self._teaching:
            new = self._board_types.put(board_type)
        armed = self._inbox.ask(self._core.orders.shown)
        later = " It holds from the next arming on." if armed and armed.board_type == board_type.name else ""
        told = f"Board type {board_type.name!r} was {'taught' if new else 'replaced'}.{later}"
        self._parts.events.add("board-type", told)
        return new

    def delete_board_type(self, name: str) -> None:
        """Forget a board type."""
        armed = self._inbox.ask(self._core.orders.shown)
        if armed is not None and armed.board_type == name:
            raise StateError(f"The line is armed for board type {name!r}.", action="Disarm first.")
        with self._teaching:
            self._board_types.delete(name)
            self._references.board_type_forgotten(name)
        self._sweep_references()
        self._parts.events.add("board-type", f"Board type {name!r} was forgotten.")

    def calibration(self) -> CalibrationStatus:
        """The calibration in force, and how the cameras stand to it."""
        return self._inbox.ask(self._parts.watch.status)

    # --- how board types are stitched

    def reference(self, board_type: str) -> ReferenceStatus:
        """The reference of a board type."""
        return self._references.status(self._board_types.get(board_type))

    def teach_reference(self, board_type: str, run: str) -> bool:
        """Make a finished run the reference of its board type."""
        known, dossier = self._board_types.get(board_type), self._parts.archive.get(run)
        calibration = self._parts.archive.calibration_of(dossier)
        with self._lease(run, "taught as the reference") as bay:
            new = self._references.teach(
                known, dossier, calibration, lambda slot: self._ring.snapshot(slot, bay.generation)
            )
        self._sweep_references()
        self._parts.events.add("reference", f"Board type {board_type!r} has it as its reference.", run=run)
        return new

    def forget_reference(self, board_type: str) -> None:
        """Place boards without a reference from the next arming on."""
        self._references.forget(self._board_types.get(board_type).name)
        self._sweep_references()
        self._parts.events.add("reference", f"Board type {board_type!r} has no reference any more.")

    def method(self, board_type: str) -> StitchingMethod:
        """How runs of a board type are stitched."""
        return self._references.method(self._board_types.get(board_type).name)

    def set_method(self, board_type: str, method: MethodName | None) -> StitchingMethod:
        """Give a board type a way of its own, from the next arming on."""
        return self._references.set_method(self._board_types.get(board_type).name, method)

    # --- runs

    def runs(self, limit: int = 50, before: str | None = None) -> tuple[RunSummary, ...]:
        """Runs, newest first."""
        return tuple(self._parts.archive.list(min(max(limit, 1), MOST_RUNS_LISTED), before))

    def run(self, run: str) -> RunDetail:
        """One run, also while it is filmed."""
        try:
            return self._inbox.ask(self._active, run) or self._parts.archive.get(run).detail
        except StateError:  # it has begun between the two questions
            return self._inbox.ask(self._active, run) or self._parts.archive.get(run).detail

    def latest(self) -> RunDetail | None:
        """The run that finished last."""
        dossier = self._parts.archive.latest()
        return dossier.detail if dossier else None

    def next_run(self, after: str | None, timeout_s: float) -> RunDetail | None:
        """The first run that finished after `after` did."""
        dossier = self._parts.archive.next(after, timeout_s)
        return dossier.detail if dossier else None

    def release(self, run: str) -> RunDetail:
        """Give up a finished run's frames."""
        self._inbox.ask(self._core.release, run)
        return self.run(run)

    def hold(self, run: str, holder: str, purpose: str) -> LeaseStatus:
        """Keep a run's frames in memory."""
        if not holder or holder.startswith(OWN):
            raise InputError.field("hold", "holder", holder, "a name by which others can find you")
        lease = self._take(run, holder, purpose)[1]
        return LeaseStatus(
            run=run, holder=holder, purpose=purpose, expires_in_s=self._inbox.ask(self._core.leases.remaining_s, lease)
        )

    def let_go(self, run: str, holder: str) -> None:
        """End a hold."""
        self._inbox.ask(self._core.let_go, run, holder)

    def stitch(self, run: str) -> Stitch:
        """The result."""
        return self._parts.archive.get(run).result

    def stitch_text(self, run: str) -> str:
        """The same as JSON text."""
        return self._parts.archive.get(run).text

    def timeline(self, run: str) -> Timeline:
        """When what happened in a finished run."""
        return self._parts.archive.get(run).timeline

    # --- pictures

    def frame(
        self, run: str, camera: int, row: int, allow_incomplete: bool = False
    ) -> tuple[NDArray[Any], FrameRecord]:
        """A copy of one frame's pixels, and its record."""
        record = self._record(run, camera, row)
        gallery.refuse_holes(
            record.verdict, record.cause, f"Frame (camera {camera}, row {row}) of run {run}", allow_incomplete
        )
        assert record.slot is not None, "only missing frames have no slot"
        with self._lease(run, f"frame {camera}/{row}") as bay:
            return self._ring.snapshot(record.slot, bay.generation), record

    def components(self, run: str) -> tuple[ComponentSummary, ...]:
        """Components of the board type the run was filmed with."""
        return gallery.components_of(self._parts.archive.get(run))

    def views(self, run: str, ref: str, px_per_mm: float | None = None, min_coverage: float = 0.5) -> tuple[View, ...]:
        """The frames that show a component."""
        return gallery.views_of_component(self._parts.archive.get(run), ref, px_per_mm, min_coverage)

    def image(
        self,
        run: str,
        ref: str,
        k: int,
        *,
        px_per_mm: float | None = None,
        format: ImageFormat = "png",
        min_coverage: float = 0.5,
    ) -> bytes:
        """Temporary image k, rendered and encoded in a worker."""
        dossier = self._parts.archive.get(run)
        view = gallery.view_of_component(dossier, ref, k, px_per_mm, min_coverage)
        record = self._record(run, view.camera, view.row)
        assert record.slot is not None, "views are of whole frames"
        with self._lease(run, f"image {ref}/{k}") as bay:
            job = RenderJob(run, bay.number, bay.generation, record.slot, view, format)
            return self._pictures.render(job, f"{ref}/{k}")

    # --- how

    def _tick(self) -> None:
        self._core.tick()
        self._gc_policy.tick(busy=bool(self._core.book.active))
        self._alive()

    def _snapshot(self) -> StationSnapshot:
        latest = self._parts.archive.latest()
        return snapshot_of(
            self._core,
            self._parts.config,
            ring=(self._ring.path, self._ring.layout.file_bytes),
            processes=self._processes(),
            last_run=latest.detail.id if latest else None,
            last_event=self._parts.events.last,
        )

    def _sweep_references(self) -> None:
        def in_use() -> set[str]:
            under_way = {p.order.reference.run for p in self._core.book.active.values() if p.order.reference}
            return under_way | self._core.orders.references

        self._references.sweep(self._inbox.ask(in_use))

    def _active(self, run: str) -> RunDetail | None:
        progress = self._core.book.active.get(run)
        return detail_of(progress) if progress else None

    def _record(self, run: str, camera: int, row: int) -> FrameRecord:
        detail = self.run(run)
        for frame in detail.frames:
            if (frame.camera, frame.row) == (camera, row):
                return frame
        if detail.state not in FINISHED and 0 <= camera < detail.cameras and row >= 0:
            raise StateError(f"Camera {camera}, row {row} of run {run} has not arrived yet.", action="Ask again.")
        raise NotFoundError(
            f"Run {run} has {detail.cameras} cameras and {detail.rows} rows, numbered from 0; "
            f"there is no camera {camera}, row {row}.",
            code="no-such-frame",
        )

    @contextmanager
    def _lease(self, run: str, purpose: str) -> Iterator[Bay]:
        """Memory that stays this run's while it is looked at."""
        holder = f"{OWN}{next(self._uses)}"
        bay, _ = self._take(run, holder, purpose)
        try:
            yield bay
        finally:
            self._inbox.post(self._core.let_go, run, holder)

    def _take(self, run: str, holder: str, purpose: str) -> tuple[Bay, Lease]:
        def take() -> tuple[Bay, Lease]:
            if not self._core.memory.has(run):
                self._active(run) or self._parts.archive.get(run)  # an unknown run is not a gone one
            return self._core.memory.bay(run), self._core.leases.take(run, holder, purpose)

        return self._inbox.ask(take)
