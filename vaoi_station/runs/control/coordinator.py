"""The coordinator: it answers every request to the station.

Requests that read or change the present state go through the inbox to `Core`, in the coordinator's thread. Finished
runs do not change, so the caller's own thread reads them from the archive. Pixels are read under a lease.
"""

from __future__ import annotations

import logging
from collections.abc import Callable
from concurrent.futures import Future
from contextlib import suppress
from dataclasses import replace
from typing import Any

from numpy.typing import NDArray

from vaoi_station.acquisition.process.messages import Report
from vaoi_station.acquisition.ring import Ring
from vaoi_station.clamping import Clamped, ClampedRequest, clamp
from vaoi_station.config import StationConfig
from vaoi_station.drift.recalibrate import Proposal
from vaoi_station.errors import DeviceError, InputError, StateError
from vaoi_station.model import Calibration, FrameRecord, Reason, Stitch
from vaoi_station.rendering import ChosenImages, ImageRequest
from vaoi_station.runs.archive import component_views
from vaoi_station.runs.archive.board_type_history import BoardTypeHistory
from vaoi_station.runs.archive.finished_runs import FinishedRun, RunFigures
from vaoi_station.runs.archive.measured_heights import MeasuredHeights
from vaoi_station.runs.archive.measured_parts import DIRECTORY as GOOD_BOARDS
from vaoi_station.runs.archive.measured_parts import MeasuredParts
from vaoi_station.runs.batches.batches import BatchAccess
from vaoi_station.runs.control.core import Core, Parts
from vaoi_station.runs.control.order_requests import MakeOrder, OrderRequests
from vaoi_station.runs.control.pictures import FrameAccess, ViewRequest
from vaoi_station.runs.control.status import line_held, renew_permit, snapshot_of, status_line
from vaoi_station.runs.control.teaching import BoardTypeRequests
from vaoi_station.runs.host.processes import GcPolicy
from vaoi_station.runs.kept_runs import KeptRuns
from vaoi_station.runs.lighting.trials import Lighting
from vaoi_station.runs.merging.merged_pictures import MergedAccess
from vaoi_station.runs.mosaics.kept_mosaics import DIRECTORY as MOSAICS
from vaoi_station.runs.mosaics.kept_mosaics import KeptMosaics
from vaoi_station.runs.mosaics.mosaics import Mosaics
from vaoi_station.runs.run.inbox import Inbox
from vaoi_station.runs.run.memory import OWN
from vaoi_station.runs.run.order import Passing
from vaoi_station.runs.run.reference_store import ReferenceStore
from vaoi_station.runs.run.run_views import detail_of
from vaoi_station.runs.states.schemas import (
    CalibrationStatus,
    ComponentSummary,
    ContactsStatus,
    EventRecord,
    ImageFormat,
    LeaseStatus,
    ProcessStatus,
    RunDetail,
    RunSummary,
    StationSnapshot,
    Timeline,
)
from vaoi_station.stitching.quality.verdict import sigma_limit_px
from vaoi_station.store import BoardTypeDirectory

_log = logging.getLogger(__name__)

ARM_LIMIT_S = 30.0
"""Longest wait for the acquisition process to confirm arming or disarming."""
MAX_RUNS_LISTED = 1000
"""Largest number of runs that one request for the list of runs returns."""


class StationCoordinator(BoardTypeRequests):
    """The station's interface for callers such as the REST service; `station.Station` starts and stops it.

    All public methods may be called from any thread. Methods that serve callers raise only `VaoiError`s.
    """

    def __init__(
        self,
        parts: Parts,
        ring: Ring,
        board_types: BoardTypeDirectory,
        make_order: MakeOrder,
        references: ReferenceStore,
        processes: Callable[[], tuple[ProcessStatus, ...]],
        faults: Callable[[], tuple[Reason, ...]] = tuple,
        show_status: Callable[[str], None] = lambda _: None,
    ) -> None:
        """Connect the parts. The coordinator's thread is not started before `start` is called.

        Args:
            parts: the objects that the coordinator's thread works with.
            ring: the shared memory that holds the frames.
            board_types: the directory of the board types.
            make_order: checks a board type and makes the order for its boards.
            references: the store of the references.
            processes: returns the states of all processes, for the snapshot.
            faults: returns one reason for each thread that has ended or hangs, at once.
            show_status: receives the station's state in one line at every tick.
        """
        super().__init__(board_types, references, parts)
        self._ring, self._make_order, self._processes, self.faults = ring, make_order, processes, faults
        self._show_status, self._gc_policy = show_status, GcPolicy()
        self._inbox = Inbox(self._tick, after=lambda: renew_permit(self._core, parts, processes, self.faults()))
        self.thread = self._inbox.thread
        """The coordinator's thread."""
        self._core, self.storage = Core(parts, self._inbox.post), parts.archive.storage
        held = lambda: line_held(self._core, parts.config, processes, self.faults())  # noqa: E731
        self.orders = OrderRequests(self._inbox, self._core, make_order, self.board_type, held)
        parts.archive.on_announced = lambda run, until_s: self._inbox.post(self._core.announced, run, until_s)
        access = self._frames = FrameAccess(self._inbox, self._core, ring, parts.archive, parts.workers)
        config, events, fields = parts.config, parts.events, parts.config.flat_fields
        self.balances_colours = fields is not None and any(
            not camera.pixel_format.startswith("Mono") for camera in config.cameras
        )
        """Whether pictures depend on flat fields."""
        pixels = parts.archive, access.lease, access.render
        self.heights = MeasuredHeights(*pixels, access.bay_of, events, fields)
        self.parts = MeasuredParts(*pixels, access.bay_of, events, config.data / GOOD_BOARDS)
        known, hastened = self.heights.known, parts.workers.hastened
        self.mosaics = Mosaics(*pixels, fields, known, hastened, access.note_fetch, access.tile)
        pictures = KeptMosaics(config.data / MOSAICS, config.keep, parts.archive, self.mosaics, access, events)
        self.kept = KeptRuns(config, parts.archive, events, access, self.heights, self.parts, pictures, access.render)
        access.heights, parts.watch.on_checked = known, self.kept.trends.checked
        if parts.px_per_mm:
            self.kept.trends.sigma_limit_px = sigma_limit_px(sum(parts.px_per_mm) / len(parts.px_per_mm))
        recorded = access.recorded = self.parts.recorded = self.kept.recordings.frame_file
        of_runs = parts.archive.get, parts.archive.explained, access.lease, recorded, access.render
        self.kept.on_identified = lambda run, found: self._inbox.post(self._core.identified, run, found)
        self.merged = MergedAccess(*of_runs, fields, known)
        self.batches = BatchAccess(*of_runs, self.merged, known, self.kept.shown)
        self.lighting = Lighting(parts.config, parts.px_per_mm, ring, self._inbox, self._core.trial, self._core.devices)
        self.board_type_history = BoardTypeHistory(board_types, self._put, self.parts.bring_back)

    # --- reports of processes, in any thread

    def acquisition_message(self, message: Report) -> None:
        """Pass a message of the acquisition process to the coordinator's thread."""
        self._inbox.post(self._core.acquisition_message, message)

    def acquisition_ended(self, description: str) -> None:
        """Let the coordinator's thread conclude the runs that were filmed when the acquisition process ended."""
        self._inbox.post(self._core.acquisition_ended, description)

    def worker_ended(self, description: str) -> None:
        """Let the coordinator's thread publish that a worker has ended."""
        self._inbox.post(self._core.worker_ended, description)

    def workers_ready(self) -> None:
        """Let the coordinator's thread publish that all workers are ready."""
        self._inbox.post(self._core.workers_ready)

    # --- start and stop

    def start(self) -> None:
        """Start the coordinator's thread."""
        self._gc_policy.start()
        self._inbox.start()
        self.kept.start()

    @property
    def grace_s(self) -> float:
        """Longest time for which the board that is passing is still filmed if the line is disarmed; 0 without one."""
        plan = self._core.line.plan
        return plan.grace_s if plan is not None and self._core.filming else 0.0

    def wind_down(self, timeout_s: float) -> None:
        """Take no more boards, and wait until all unfinished runs have ended or `timeout_s` has passed."""
        stopped: Future[None] = Future()
        with suppress(TimeoutError):  # The next start marks runs that have not ended by then as failed.
            self._inbox.wait(stopped, lambda: self._core.stop(stopped), timeout_s)

    def close(self) -> None:
        """End the coordinator's thread. Callers that still wait receive a refusal."""
        self.kept.stop()
        self._inbox.close()
        self._gc_policy.stop()
        self._parts.archive.close()
        self._parts.events.close()

    # --- the station

    def snapshot(self) -> StationSnapshot:
        """Return state, health, memory and versions of the station at this moment."""
        return self.kept.with_counts(self._inbox.ask(self._snapshot))

    def contacts(self) -> ContactsStatus | None:
        """Return the neighbours by their contacts; None without a table [smema] in station.toml."""
        core = self._core
        return self._inbox.ask(lambda: core.contacts.status(core.health.contacts if core.health is not None else None))

    def take_board_out(self, board: str) -> None:
        """Take that a board was taken out behind the cameras; `StateError` if contacts do not offer it."""
        self._inbox.ask(lambda: self._core.contacts.remove(board))

    def arm(
        self,
        board_type: str | None,
        board_id: str | None = None,
        job_id: str | None = None,
        runs: int | None = None,
        allow_lost_cameras: bool = False,
        passing: Passing = "wait",
    ) -> StationSnapshot:
        """Arm the line: film every board from now on, or only the next `runs` boards; None: those with an order.

        Returns once the order is in force. A board that is passing keeps the order before: the new one waits until it
        has left, or this returns at once and the order takes effect then ("after"), or it is refused ("refuse").

        Raises:
            NotFoundError: the board type is unknown.
            BusyError: all memory is in use; the message names the holders.
            StateError: a board is passing and `passing` is "refuse", boards follow for too long, or a fault.
            DeviceError: a camera is lost and `allow_lost_cameras` is False, or a device cannot be armed.
        """
        if runs is not None and runs < 1:
            raise InputError.field("arm", "runs", runs, "at least 1, or absent")
        if board_type is None and allow_lost_cameras:
            raise InputError.field("arm", "allow_lost_cameras", True, "stated by each order that waits")
        # An unusable board type is refused here, in the caller's thread, before a board comes.
        order = None
        if board_type is not None:
            order = self._make_order(self.board_type(board_type), board_id, job_id)
            order = replace(order, despite_lost_cameras=allow_lost_cameras)
        self.orders.renew()
        armed: Future[None] = Future()
        waits = self._inbox.ask(self._core.arm, order, runs, armed, passing)
        for left in reversed(range(waits)):
            try:
                self._inbox.wait(armed, lambda: None, ARM_LIMIT_S)
                break
            except TimeoutError:
                if self._inbox.ask(self._core.line.withdraw, armed):
                    message = f"Boards passed without a gap for {ARM_LIMIT_S:.0f} s; the order before stays in force."
                    action = "Arm with passing=after, which takes effect in the next gap."
                    raise StateError(message, action=action) from None
                if not left:
                    self._inbox.post(self._core.line.disarm, Future())
                    message = f"Cameras and controller were not ready in {ARM_LIMIT_S:.0f} s; the line was disarmed."
                    action = "Check the health of cameras and controller."
                    raise DeviceError(message, action=action, code="arming-failed") from None
        return self.snapshot()

    def disarm(self) -> StationSnapshot:
        """Disarm the line, and return when that is confirmed: a board that passes is filmed for at most `grace_s`."""
        disarmed: Future[None] = Future()
        limit_s = ARM_LIMIT_S + self.grace_s
        try:
            self._inbox.wait(disarmed, lambda: self._core.line.disarm(disarmed), limit_s)
        except TimeoutError:
            message = f"The acquisition process did not disarm within {limit_s:.0f} s."
            raise DeviceError(message, code="disarming-failed") from None
        return self.snapshot()

    def events(self, after: int = 0, timeout_s: float = 0.0, limit: int = 1000) -> tuple[EventRecord, ...]:
        """Return at most `limit` events with numbers above `after`, oldest first; wait up to `timeout_s` for one."""
        return self._parts.events.read(after, timeout_s, limit)

    def calibration(self) -> CalibrationStatus:
        """Return the calibration in force, with the displacement of every camera from it in the latest runs."""
        return self._inbox.ask(self._parts.watch.status)

    def exchange_proposal(self) -> Proposal:
        """Return the calibration with its exchanged cameras, by the boards since.

        InputError: all cameras are calibrated, or the boards do not suffice; the message has the cause.
        """
        return self._inbox.ask(self._parts.watch.proposal)

    def require_disarmed(self) -> None:
        """Raise StateError unless the line is disarmed."""
        self._inbox.ask(self._core.require_disarmed)

    def exchange_camera(self, camera: int, serial: str, address: str, calibration: Calibration | None) -> None:
        """Use the camera with this serial number and address in the place of another, with this calibration.

        StateError: the line is armed.
        """
        self._inbox.ask(self._core.exchange_camera, camera, serial, address, calibration)

    def to_open(self) -> StationConfig:
        """Return the configuration for an acquisition process that begins now."""
        return self._core.places.to_open(self._core.config)

    def use_calibration(self, calibration: Calibration) -> None:
        """Use another calibration from now on. StateError: the line is armed."""
        self._inbox.ask(self._core.use_calibration, calibration)

    # --- runs

    def runs(self, limit: int = 50, before: str | None = None) -> tuple[RunSummary, ...]:
        """Return at most `limit` runs, newest first. If `before` is given, return only runs older than this id."""
        return tuple(self._parts.archive.list(min(max(limit, 1), MAX_RUNS_LISTED), before))

    def run(self, run: str) -> RunDetail:
        """Return the document of a run, finished or not; `NotFoundError` if there is no run with this id."""
        try:
            return self._inbox.ask(self._active, run) or self._parts.archive.get(run).detail
        except StateError:  # The run began between the two look-ups, so it is now among the active runs.
            return self._inbox.ask(self._active, run) or self._parts.archive.get(run).detail

    def camera_serials(self, run: str) -> tuple[str | None, ...]:
        """Return the serial numbers of the cameras that filmed a finished run, by place; None if one is not known."""
        head = self._parts.archive.get(run).head
        return tuple(camera.serial for camera in head.cameras) if head is not None else ()

    def run_figures(self) -> RunFigures:
        """Return counts and waiting times of the runs that ended since the start."""
        return self._parts.archive.statistics.figures()

    def latest(self) -> RunDetail | None:
        """Return the run that finished last; None if no run has finished yet."""
        finished = self._parts.archive.latest()
        return finished.detail if finished else None

    def next_run(self, after: str | None, timeout_s: float) -> RunDetail | None:
        """Return the first run that finishes after the run `after`; None if `timeout_s` passes without one.

        If `after` is None, return the first run that finishes after this call.
        """
        finished = self._parts.archive.next(after, timeout_s)
        return finished.detail if finished else None

    def release(self, run: str, holder: str | None = None) -> RunDetail:
        """Give up the frames of a finished run, and end the hold of `holder`; `StateError` if another one holds it."""
        self._inbox.ask(self._core.release, run, holder)
        return self.run(run)

    def hold(self, run: str, holder: str, purpose: str) -> LeaseStatus:
        """Keep the frames of a run in memory for the configured time `lease_s`; the same call again renews the hold.

        GoneError: the frames are no longer in memory. BusyError: the run has too many holders.
        """
        if not holder or holder.startswith(OWN):
            raise InputError.field("hold", "holder", holder, "a name that identifies the holder")
        _, lease = self._frames.take_lease(run, holder, purpose)
        remaining_s = self._inbox.ask(self._core.memory.remaining_s, lease)
        return LeaseStatus(run=run, holder=holder, purpose=purpose, expires_in_s=remaining_s)

    def end_hold(self, run: str, holder: str) -> None:
        """End a holder's hold on a run's frames. Nothing happens if there is no such hold."""
        self._inbox.ask(self._core.end_lease, run, holder)

    def stitch(self, run: str) -> Stitch:
        """Return the complete result; `StateError` before the run has ended, `NotFoundError` if it has no result."""
        return self._parts.archive.explained(run).result

    def stitch_text(self, run: str) -> str:
        """Return the result of a run as JSON text, complete or not; raises the errors of `stitch`."""
        return self._parts.archive.get(run).text

    def is_complete(self, run: str) -> bool:
        """Return whether the result of a run has all its entries; raises the errors of `stitch`."""
        return self._parts.archive.get(run).complete

    def timeline(self, run: str) -> Timeline:
        """Return the times of the steps of a finished run."""
        return self._parts.archive.get(run).timeline

    # --- pictures

    def frame(
        self, run: str, camera: int, row: int, allow_incomplete: bool = False
    ) -> tuple[NDArray[Any], FrameRecord]:
        """Return a copy of one frame's pixels, (h, w) uint8 or uint16, and its record.

        Raises:
            GoneError: the memory of the frame was given to a later board, and it is in no recording of the run.
            NotFoundError: the run has no such frame, or the frame never arrived.
            StateError: the frame may still arrive, or it is incomplete or not proven and `allow_incomplete` is
                False.
        """
        return self._frames.frame(self.run(run), camera, row, allow_incomplete)

    def clamped(self, run: str, request: ClampedRequest) -> Clamped:
        """Return where the board of a run lies that a tester has clamped, from its readings of fiducials.

        InputError: a reading or a point names what the board type does not have. StateError: no CAD mapping.
        """
        film = component_views.filmed_board(self._parts.archive.explained(run), self.heights.known(run))
        answer = clamp(film, request)
        for reason in answer.reasons:
            _log.warning("hand-over of run %s is %s: %s", run, answer.status, reason.message)
        return answer

    def finished(self, run: str) -> FinishedRun:
        """Return the complete record of a run that has ended."""
        return self._parts.archive.get(run)

    def components(self, run: str) -> tuple[ComponentSummary, ...]:
        """Return the components of the run's board type, with their positions in tester coordinates."""
        return component_views.components_of(self._parts.archive.get(run))

    def images(self, run: str, ref: str, wanted: ImageRequest = ImageRequest()) -> ChosenImages:  # noqa: B008
        """Choose the temporary images of a component, by its address `panel/ref` or `ref`; each can be rendered."""
        return self._frames.images(self._parts.archive.get(run).detail, ref, wanted)

    def image(
        self,
        run: str,
        ref: str,
        k: int,
        wanted: ImageRequest = ImageRequest(),  # noqa: B008  it is immutable
        *,
        format: ImageFormat = "png",
    ) -> bytes:
        """Have a worker render image k of the list that `images` returns for the same request; return the file."""
        detail = self._parts.archive.get(run).detail
        return self._frames.image(detail, ViewRequest(ref, k, wanted), format)

    # --- in the coordinator's thread

    def _tick(self) -> None:
        self._core.tick()
        # A full garbage collection would delay the tasks of the frames of a board that passes, and every reply.
        self._gc_policy.tick(busy=self._frames.in_use())
        self._show_status(status_line(self._core))

    def _snapshot(self) -> StationSnapshot:
        ring = self._ring.path, self._ring.layout.file_bytes
        return snapshot_of(self._core, self._parts, ring=ring, processes=self._processes(), faults=self.faults())

    def _active(self, run: str) -> RunDetail | None:
        progress = self._core.active.get(run)
        return detail_of(progress) if progress else None
