"""The coordinator: every request to the station, answered through one thread.

Requests about the present go through the inbox to `Core`. Finished runs never change: they are read from the archive in
the caller's own thread. Pixels are copied or rendered under a lease.
"""

from __future__ import annotations

from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from typing import Any

from numpy.typing import NDArray

from vaoi_station.acquisition.ring.ring import Ring
from vaoi_station.config import MethodName
from vaoi_station.errors import DeviceError, InputError, StateError
from vaoi_station.model import BoardType, FrameRecord, Stitch
from vaoi_station.rendering import View
from vaoi_station.runs.archive import component_views
from vaoi_station.runs.control.core import Core, Parts
from vaoi_station.runs.control.inbox import Inbox
from vaoi_station.runs.control.inbox_events import InboxEvents
from vaoi_station.runs.control.pictures import FrameAccess, PictureRequests, ViewRequest
from vaoi_station.runs.control.station_events import StationEvents
from vaoi_station.runs.control.status import snapshot_of
from vaoi_station.runs.control.teaching import BoardTypeService, ReferenceTeaching
from vaoi_station.runs.host.gc_policy import GcPolicy
from vaoi_station.runs.run.leases import OWN
from vaoi_station.runs.run.order import Order
from vaoi_station.runs.run.reference_store import ReferenceStore
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
from vaoi_station.store import BoardTypeDirectory

ARM_LIMIT_S = 30.0
"""Longest wait for the acquisition process to confirm arming or disarming."""
MAX_RUNS_LISTED = 1000

MakeOrder = Callable[[BoardType, "str | None", "str | None"], Order]


class StationCoordinator:
    """The station as its callers see it; `station.Station` starts and stops it.

    All public methods may be called from any thread; those that answer callers raise `VaoiError`s only.
    """

    def __init__(
        self,
        parts: Parts,
        ring: Ring,
        board_types: BoardTypeDirectory,
        make_order: MakeOrder,
        references: ReferenceStore,
        processes: Callable[[], tuple[ProcessStatus, ...]],
        alive: Callable[[], None] = lambda: None,
    ) -> None:
        """Connect the parts; nothing runs before `start`.

        Args:
            parts: everything the coordinator's thread works with.
            ring: memory of the frames.
            board_types: directory of the board types.
            make_order: checks a board type and makes the order for its boards.
            references: store of the references.
            processes: states of the processes, for the snapshot.
            alive: called at every tick, for a watchdog.
        """
        self._parts, self._ring = parts, ring
        self._make_order, self._processes, self._alive = make_order, processes, alive
        self._inbox = Inbox(self._tick)
        self._gc_policy = GcPolicy()
        self._core = Core(parts)
        requests = PictureRequests(parts.workers)
        self._frames = FrameAccess(self._inbox, self._core, ring, parts.archive, requests)
        self._board_types = BoardTypeService(
            board_types,
            ReferenceTeaching(references, parts.config.method),
            parts.archive,
            parts.events,
            self._core,
            self._inbox,
            self._frames,
        )
        self.process_events: StationEvents = InboxEvents(self._inbox, self._core, requests)
        """Receives what the acquisition process and the workers report."""

    # --- start and stop

    def start(self) -> None:
        """Start the thread."""
        self._gc_policy.start()
        self._inbox.start()

    def wind_down(self, timeout_s: float) -> None:
        """Take no more boards, and wait until the runs under way have ended or the time has passed."""
        stopped: Future[None] = Future()
        try:
            self._inbox.wait(stopped, lambda: self._core.stop(stopped), timeout_s)
        except TimeoutError:
            return  # runs that are not done by then are marked as failed at the next start

    def close(self) -> None:
        """End the thread; callers that still wait are refused."""
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
        """Film every board from now on, or the next `runs`; returns once cameras and controller are armed.

        While the line is armed, the new order applies to the boards that come from now on.

        Raises:
            NotFoundError: the board type is unknown.
            BusyError: all memory is in use; the message names the holders.
            StateError: a board is passing, or the station is faulted.
            DeviceError: a camera is lost (unless allowed), or a device cannot be armed.
        """
        if runs is not None and runs < 1:
            raise InputError.field("arm", "runs", runs, "at least 1, or absent")
        # Everything that can be wrong with the board type is found here: in the caller's thread, before a board comes.
        order = self._make_order(self._board_types.get(board_type), board_id, job_id)
        order = replace(order, despite_lost_cameras=allow_lost_cameras)
        armed: Future[None] = Future()
        try:
            self._inbox.wait(armed, lambda: self._core.arm(order, runs, armed), ARM_LIMIT_S)
        except TimeoutError:
            self._inbox.post(self._core.disarm, Future())
            raise DeviceError(
                f"Cameras and controller were not ready within {ARM_LIMIT_S:.0f} s; the line was disarmed.",
                action="Check the health of cameras and controller.",
                code="arming-failed",
            ) from None
        for note in order.notes:
            self._parts.events.add("trouble", note.message, code=note.code, action=note.action)
        return self.snapshot()

    def disarm(self) -> StationSnapshot:
        """Ignore the barrier; a run under way is finished with what it has. Harmless when idle."""
        disarmed: Future[None] = Future()
        try:
            self._inbox.wait(disarmed, lambda: self._core.disarm(disarmed), ARM_LIMIT_S)
        except TimeoutError:
            raise DeviceError(
                f"The acquisition process did not disarm within {ARM_LIMIT_S:.0f} s.", code="disarming-failed"
            ) from None
        return self.snapshot()

    def events(self, after: int = 0, timeout_s: float = 0.0, limit: int = 1000) -> tuple[EventRecord, ...]:
        """Events numbered above `after`, oldest first; waits up to `timeout_s` for one."""
        return self._parts.events.read(after, timeout_s, limit)

    def calibration(self) -> CalibrationStatus:
        """Return the calibration in force, and how the cameras have stood to it in the latest runs."""
        return self._inbox.ask(self._parts.watch.status)

    # --- board types, their references and methods

    def board_types(self) -> tuple[BoardTypeSummary, ...]:
        """All board types, by name; unusable files are listed with their fault."""
        return self._board_types.list()

    def board_type(self, name: str) -> BoardType:
        """One board type; `NotFoundError` if there is none of that name."""
        return self._board_types.get(name)

    def put_board_type(self, board_type: BoardType) -> bool:
        """Add or replace a board type; True if it is new. Runs keep theirs, an armed line the one it was armed with."""
        return self._board_types.put(board_type)

    def delete_board_type(self, name: str) -> None:
        """Delete a board type; `StateError` while the line is armed with it."""
        self._board_types.delete(name)

    def reference(self, board_type: str) -> ReferenceStatus:
        """Return the reference of a board type; `NotFoundError` if it has none."""
        return self._board_types.reference(board_type)

    def teach_reference(self, board_type: str, run: str) -> bool:
        """Make a finished run the reference of its board type, from the next arming on; True if it had none.

        Raises:
            NotFoundError: there is no such run or board type.
            InputError: the run shows another board type.
            StateError: the run has no result yet, or not one that is ok.
            GoneError: its frames are gone.
        """
        return self._board_types.teach_reference(board_type, run)

    def forget_reference(self, board_type: str) -> None:
        """Place boards without a reference from the next arming on; `NotFoundError` if there is none."""
        self._board_types.forget_reference(board_type)

    def method(self, board_type: str) -> StitchingMethod:
        """Return the method by which runs of a board type are stitched."""
        return self._board_types.method(board_type)

    def set_method(self, board_type: str, method: MethodName | None) -> StitchingMethod:
        """Give a board type a method of its own from the next arming on; None: use that of the station."""
        return self._board_types.set_method(board_type, method)

    # --- runs

    def runs(self, limit: int = 50, before: str | None = None) -> tuple[RunSummary, ...]:
        """Return runs, newest first; `before`: only those older than this id."""
        return tuple(self._parts.archive.list(min(max(limit, 1), MAX_RUNS_LISTED), before))

    def run(self, run: str) -> RunDetail:
        """One run, also while it is filmed; `NotFoundError` if there was none of that id."""
        try:
            return self._inbox.ask(self._active, run) or self._parts.archive.get(run).detail
        except StateError:  # the run began between the two look-ups: it is active now
            return self._inbox.ask(self._active, run) or self._parts.archive.get(run).detail

    def latest(self) -> RunDetail | None:
        """Return the run that finished last; None before the first."""
        finished = self._parts.archive.latest()
        return finished.detail if finished else None

    def next_run(self, after: str | None, timeout_s: float) -> RunDetail | None:
        """Return the first run that finished after `after` did (None: after this call); None on time-out.

        A caller that passes the id it received last gets every finished run once.
        """
        finished = self._parts.archive.next(after, timeout_s)
        return finished.detail if finished else None

    def release(self, run: str) -> RunDetail:
        """Give up a finished run's frames; the result stays. `StateError` while it is filmed or stitched."""
        self._inbox.ask(self._core.release, run)
        return self.run(run)

    def hold(self, run: str, holder: str, purpose: str) -> LeaseStatus:
        """Keep a run's frames in memory for `lease_s`; the same call again renews. `GoneError` if too late."""
        if not holder or holder.startswith(OWN):
            raise InputError.field("hold", "holder", holder, "a name that identifies the holder")
        _, lease = self._frames.take_lease(run, holder, purpose)
        remaining_s = self._inbox.ask(self._core.leases.remaining_s, lease)
        return LeaseStatus(run=run, holder=holder, purpose=purpose, expires_in_s=remaining_s)

    def end_hold(self, run: str, holder: str) -> None:
        """End a hold; harmless if there is none."""
        self._inbox.ask(self._core.end_lease, run, holder)

    def stitch(self, run: str) -> Stitch:
        """Return the result; `StateError` while there is none yet, `NotFoundError` if the run ended without one."""
        return self._parts.archive.get(run).result

    def stitch_text(self, run: str) -> str:
        """Return the result as JSON text."""
        return self._parts.archive.get(run).text

    def timeline(self, run: str) -> Timeline:
        """Return the times of the steps of a finished run."""
        return self._parts.archive.get(run).timeline

    # --- pictures

    def frame(
        self, run: str, camera: int, row: int, allow_incomplete: bool = False
    ) -> tuple[NDArray[Any], FrameRecord]:
        """Return a copy of one frame's pixels, (h, w) uint8 or uint16, and its record.

        Raises:
            GoneError: the memory was given to a later board.
            NotFoundError: there is no such frame, or it never arrived.
            StateError: it is incomplete and that is not allowed, or not settled yet.
        """
        return self._frames.frame(self.run(run), camera, row, allow_incomplete)

    def components(self, run: str) -> tuple[ComponentSummary, ...]:
        """Components of the board type the run was filmed with, and their positions."""
        return component_views.components_of(self._parts.archive.get(run))

    def views(self, run: str, ref: str, px_per_mm: float | None = None, min_coverage: float = 0.5) -> tuple[View, ...]:
        """Return the views of a component (address `panel/ref` or `ref`), as temporary images to be rendered."""
        return component_views.views_of_component(self._parts.archive.get(run), ref, px_per_mm, min_coverage)

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
        """Temporary image k of `views(…)` with the same arguments, rendered and encoded in a worker."""
        detail = self._parts.archive.get(run).detail
        return self._frames.image(detail, ViewRequest(ref, k, px_per_mm, min_coverage), format)

    # --- in the coordinator's thread

    def _tick(self) -> None:
        self._core.tick()
        # A garbage collection while a board passes would delay its frames' tasks.
        self._gc_policy.tick(busy=bool(self._core.runs.active))
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

    def _active(self, run: str) -> RunDetail | None:
        progress = self._core.runs.active.get(run)
        return detail_of(progress) if progress else None
