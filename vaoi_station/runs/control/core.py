"""The decisions of the coordinator's thread: how the station reacts to requests, reports of processes and ticks.

| state of a run | what happens | what follows |
|---|---|---|
| filming | a pulse, a frame | its `RunStitcher` asks for the links that become possible |
| filming | the last frame is settled | stitching; the stitcher has the run concluded |
| filming | the acquisition process ends | as if the last frame was settled, with what had arrived |
| stitching | the stitcher answers | the run is done, with a result or without; its calibration is checked |
| done | all earlier runs have ended | ready, degraded or failed; the archive stores and announces it |
"""

from __future__ import annotations

import itertools
import time
from collections.abc import Callable
from dataclasses import dataclass, replace
from functools import partial
from typing import assert_never

from vaoi_station.acquisition.controller.announced import Came
from vaoi_station.acquisition.process import messages
from vaoi_station.config import StationConfig
from vaoi_station.errors import StateError, VaoiError
from vaoi_station.model import Calibration, Reason, Status
from vaoi_station.model.board_identity import IdentityDocument
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.control import readiness
from vaoi_station.runs.control.calibration_watch import CalibrationWatch
from vaoi_station.runs.control.camera_places import CameraPlaces
from vaoi_station.runs.control.contacts import LineContacts
from vaoi_station.runs.control.line_control import Acquisition, Completion, LineControl
from vaoi_station.runs.control.readiness import LinePermit
from vaoi_station.runs.control.reasons import StationStateMachine, sentence
from vaoi_station.runs.lighting.trials import CameraTrial
from vaoi_station.runs.run.boards import UNWATCHED, BoardAccount, TriggerWatch
from vaoi_station.runs.run.memory import Memory
from vaoi_station.runs.run.order import Order, Passing
from vaoi_station.runs.run.progress import WHOLE, Progress
from vaoi_station.runs.run.standing_order import Resumed, StandingOrder
from vaoi_station.runs.run.verdict import conclude, with_faults
from vaoi_station.runs.states.run_ids import RunIds, utc
from vaoi_station.runs.states.tables import RunState, RunStep, StationState, StationStep
from vaoi_station.runs.workers.jobs import Explained, ExplainJob, Reply
from vaoi_station.runs.workers.run_stitcher import Stitched, Workers
from vaoi_station.store.documents import KeyedTexts


@dataclass(frozen=True)
class Parts:
    """The objects with which the coordinator works, such as the archive and the workers."""

    config: StationConfig
    renew: Callable[[int], int]
    """Raises the generation of a bay of the ring, and returns it."""
    acquisition: Acquisition
    workers: Workers
    archive: Archive
    events: EventLog
    run_ids: RunIds
    watch: CalibrationWatch
    standing: StandingOrder | None = None
    """The object that stores the order in force for a restart; None if orders are not stored."""
    resumed: Resumed | None = None
    """The order that was in force when the station ended."""
    other_warnings: Callable[[], tuple[Reason, ...]] = tuple
    """Returns, at once, warnings of what the coordinator does not know: receivers of events, a missing calibration."""
    px_per_mm: tuple[float, ...] = ()
    """Resolution of every camera by its calibration; empty: the nominal ones of station.toml count."""
    cameras: KeyedTexts | None = None
    """Where it is stored what the cameras are, and the boards behind them; None if it is not."""
    use_calibration: Callable[[Calibration], None] = lambda _: None
    """Lets orders and references use another calibration from now on."""
    use_config: Callable[[StationConfig], None] = lambda _: None
    """Lets the next acquisition process and the next runs use another configuration."""


class Core:
    """Decides how the station reacts to requests, reports of processes and ticks.

    It is used by the coordinator's thread only, to which reports and replies of other threads are posted.
    """

    def __init__(self, parts: Parts, post: Callable[..., object] = lambda work, *args: work(*args)) -> None:
        """Connect the parts. `post` lets the coordinator's thread call a function with arguments."""
        config, events = parts.config, parts.events
        self._post, self._parts, self._config, self._events = post, parts, config, events
        self.watch, self.storage, self._archive = parts.watch, parts.archive.storage, parts.archive
        self.other_warnings = parts.other_warnings
        self.memory = Memory(parts.renew, config.ring.runs, config.ring.lease_s)
        self._archive.keep_s = config.ring.keep_s
        self.machine = StationStateMachine(events)
        self.line = LineControl(
            config,
            parts.acquisition,
            self.machine,
            self.memory,
            parts.run_ids,
            parts.archive,
            events,
            parts.standing,
        )
        if parts.resumed is not None:
            self.line.resume(parts.resumed)
        self.contacts = LineContacts(config.smema, parts.acquisition.send, events.add, parts.cameras)
        self.boards = BoardAccount(config.line, self.line.orders, events.add, self.contacts.missed)
        self.active: dict[str, Progress] = {}
        """The runs that are filmed or stitched, in the order of their boards."""
        self._explaining: set[str] = set()
        """The finished runs whose result is not complete yet."""
        self._leaving: dict[str, bool] = {}
        """The finished runs that are not announced yet, and whether their boards leave as failed ones."""
        self.trigger = TriggerWatch([camera.label for camera in config.cameras])
        interlocked = config.controller.interlock == "on"
        self.permit = LinePermit(parts.acquisition.send if interlocked else None, events.add)
        self.places = CameraPlaces(parts.cameras, len(config.cameras))
        self.lost_since: dict[int, str] = {}
        """Time at which each camera was lost that is not connected."""
        self._stopping: list[Completion] = []
        on_evicted = partial(self.line.evicted, room_for="a trial of a camera")
        self.trial = CameraTrial(parts.acquisition, lambda: self.machine.state, self.memory, on_evicted)

    @property
    def config(self) -> StationConfig:
        """The configuration in force: that of the start, with the cameras that were exchanged since."""
        return self._config

    @property
    def health(self) -> messages.Health | None:
        """The latest report of the devices; None while there is none."""
        return self.line.health

    @property
    def filming(self) -> list[Progress]:
        """The runs whose board is passing the cameras, oldest first."""
        return [progress for progress in self.active.values() if progress.state is RunState.FILMING]

    # --- requests of callers

    def arm(self, order: Order | None, runs: int | None, completion: Completion, passing: Passing = "wait") -> int:
        """Arm the line. The completion is set once the order is in force, or carries the refusal.

        Returns for how many things the caller waits in turn: a board that passes, then cameras and controller. 0: the
        order takes effect when the board has left, and the caller does not wait for it.
        """
        if order is not None and order.calibration_digest != self.watch.digest:
            # It was made, in the thread of the caller, just before another calibration came into force.
            raise StateError("The calibration was changed at this moment.", action="Arm again.")
        board_passes = self.machine.state is StationState.FILMING
        if board_passes and passing == "refuse":
            self.machine.require(StationStep.ARM)
        later = board_passes and passing == "after"
        completion.add_done_callback(partial(self._report_order, order, later))
        self.line.arm(order, runs, completion)
        return 0 if later else 2 if board_passes else 1

    def _report_order(self, order: Order | None, later: bool, completion: Completion) -> None:
        """Publish the notes of an order that is in force, and why one did not take effect if no caller waits for it."""
        refusal = completion.exception()
        if refusal is None:
            for note in order.notes if order is not None else ():
                self._events.add("trouble", note.message, code=note.code, action=note.action)
        elif later and isinstance(refusal, VaoiError):
            message = f"The order given while a board passed did not take effect: {refusal.message}"
            self._events.add("trouble", message, code=refusal.code, action=refusal.action)

    def release(self, run: str, holder: str | None = None) -> None:
        """Give up the frames of a finished run, and end the hold of `holder`; `StateError` if another one holds it."""
        if run in self.active:
            message = f"Run {run} is {self.active[run].state}; its memory is needed."
            raise StateError(message, action="Wait for its result.")
        if others := [lease for lease in self.memory.leases_of_callers(run) if lease.holder != holder]:
            names = ", ".join(map(str, others))
            left_s = max(self.memory.remaining_s(lease) for lease in others)
            raise StateError(
                f"Run {run} is held by {names} for at most another {left_s:.0f} s; nothing was released.",
                action="Its holder releases it with its name (release?holder=NAME) or ends its hold; or wait.",
                code="held",
            )
        self._archive.mark(run, RunStep.RELEASE)
        self.memory.free(run)
        self._events.add("run", "Frames released.", state=RunState.RELEASED, run=run)
        self.line.keep_memory_granted()

    def end_lease(self, run: str, holder: str) -> None:
        """End a holder's lease of a run. If the line was blocked for lack of memory, it may continue now."""
        self.memory.end_lease(run, holder)
        self.line.keep_memory_granted()

    def announced(self, run: str, until_s: float) -> None:
        """Keep the frames of an announced run until a host time, unless released before; its board may leave now."""
        if (failed := self._leaving.pop(run, None)) is not None:
            self.contacts.ended(run, failed=failed)
        self.memory.keep(run, until_s)
        self.line.keep_memory_granted()

    def stop(self, completion: Completion) -> None:
        """Take no more boards. The completion is set when all unfinished runs have ended."""
        self.line.disarm_for_stop()
        self.machine.advance(StationStep.STOP)
        self._stopping.append(completion)
        self._complete_stop_if_drained()

    def require_disarmed(self) -> None:
        """Raise StateError if boards may come: what their runs need must not change."""
        if self.line.orders.armed or self.filming:
            doing = "A board is passing" if self.filming else "The line is armed"
            raise StateError(f"{doing}; nothing was changed.", action="Disarm the line, then do it.", code="line-armed")

    def exchange_camera(self, camera: int, serial: str, address: str, calibration: Calibration | None) -> None:
        """Use another camera in the place of one that is gone, and this calibration, if the station has one."""
        self.require_disarmed()
        before, name = self.places.cameras[camera].serial, self._config.cameras[camera].name
        config = self._config.with_serial(camera, serial)
        # Stored first: if that fails, nothing has changed.
        self._parts.use_config(config)
        if calibration is not None:
            self.use_calibration(calibration)
        self._config = config
        self._parts.acquisition.send(messages.ReplaceCamera(camera, serial, address))
        message = f"Camera {name} was exchanged: {serial} is in the place of {before or 'an unknown one'}."
        self._events.add("camera", message, subject={"camera": name}, code="camera-exchanged")

    def use_calibration(self, calibration: Calibration) -> None:
        """Use another calibration for the boards of all later orders."""
        self.require_disarmed()
        self._parts.use_calibration(calibration)
        self.watch.adopt(calibration)
        made = calibration.created or "unknown when"
        self._events.add("calibration", f"Another calibration is in force, made {made}.")

    def identified(self, run: str, found: IdentityDocument) -> None:
        """Compare the id that was read from a board with the orders that wait: boards may be out of step with them."""
        orders, read = self.line.orders, found.board_id
        if read is None or not found.read or orders.queue.first is None:
            return
        waits = any(queued.order.board_id == read for queued in orders.queue.waiting)
        if waits or found.armed_board_id not in (None, read):
            order = "whose order still waits" if waits else f"but took the order of {found.armed_board_id!r}"
            orders.doubt(float("-inf"), time.monotonic(), f"run {run} showed board {read!r}, {order}")
            message = f"The board of this run is {read!r}, {order}: boards and orders are out of step."
            action = "Compare the boards on the line with the orders, withdraw those that have passed, and arm again."
            self._events.add("trouble", message, run=run, code="orders-out-of-step", action=action)

    def devices(self) -> messages.Health | None:
        """Return the latest report of the devices; None while there is none."""
        return self.health

    def tick(self) -> None:
        """Remove expired leases and troubles, and try to grant memory again. The inbox calls this every tick."""
        for lease in self.memory.expire():
            self._events.add("lease", f"The hold of {lease} expired.", run=lease.run)
        # In the states FAULTED and ARMING, callers need the reasons to act: reasons stay until the state changes.
        if self.machine.state not in (StationState.FAULTED, StationState.ARMING):
            self.machine.reasons.expire()
        for run in self.memory.reclaim(self.active):
            self._events.add("trouble", "The run ended by a fault; its memory is free again.", run=run, code="store")
            self.contacts.ended(run, failed=True)
        self.line.tick()
        self.line.keep_memory_granted()
        self._archive.tick()
        self.trial.tick()

    # --- reports of the workers

    def stitched(self, run: str, stitched: Stitched) -> None:
        """Take the answer of a run's stitcher."""
        if (progress := self.active.get(run)) is None:
            return
        progress.take(stitched)
        self._end_in_order()

    def explained(self, job: ExplainJob, reply: Reply, again: ExplainJob | None = None) -> None:
        """Take the complete result of a finished run, and the check of the calibration with it.

        If its worker has ended, another one does the job `again`.
        """
        answer: Explained | None = reply.value
        if answer is None and again is not None and not self._stopping:
            self._parts.workers.submit(again, partial(self._post, self.explained, again))
            return
        self._explaining.discard(job.run)
        try:
            document = reply if answer is None else answer.document
            self._archive.explain(job.run, document.value, "" if document.error is None else document.error.message)
            check = reply if answer is None else answer.check
            if job.check is not None and check is not None:
                self.watch.checked(job.check, check)
        finally:
            self._complete_stop_if_drained()

    def worker_ended(self, description: str) -> None:
        """Publish that a worker process has ended. The pool then restarts the process."""
        self._events.add("process", description)

    def workers_ready(self) -> None:
        """Publish that all workers are ready."""
        self._events.add("workers", "The workers are ready: results come at once.")

    # --- reports of the acquisition process

    def acquisition_message(self, message: messages.Report) -> None:  # noqa: PLR0912  one case for each message
        """Act on a message of the acquisition process, by its type."""
        if self.trial.takes(message):
            return
        # The most frequent kinds are tested first: a station of 8 cameras sends hundreds of frames per second.
        match message:
            case messages.FrameSettled():
                progress = self.active.get(message.run)
                if progress is not None and progress.state is RunState.FILMING:
                    progress.stitcher.settle(message.frame, message.host_time_s)
            case messages.PulseReported():
                if (progress := self.active.get(message.run)) is not None:
                    progress.pulses[message.pulse.index] = message.pulse
            case messages.Health():
                for change in readiness.changes(self.health, message, self._config.cameras):
                    self._events.add("camera", change)
                self.lost_since = {k: self.lost_since.get(k) or utc() for k in readiness.disconnected(message)}
                self.line.health = message
                self.places.note(message, self._config.cameras)
            case messages.RunStarted():
                self._on_run_started(message)
            case messages.RunFinished():
                self._on_run_finished(message)
            case messages.Trouble():
                self._on_trouble(message)
            case messages.BoardMissed():
                self._on_board_missed(message)
            case messages.MissedPassage():
                self.boards.passage_missed(message, time.monotonic())
            case messages.Armed():
                self.line.on_armed()
            case messages.Disarmed():
                self.line.on_disarmed(message)
            case messages.Ready():
                self.line.on_ready()
            case messages.TrialFailed():
                pass  # its caller is gone: the acquisition process was restarted meanwhile
            case _:
                assert_never(message)

    def acquisition_ended(self, description: str) -> None:
        """Conclude the runs that were being filmed when the acquisition process ended, and take its memory back.

        `AcquisitionLink` restarts the process.
        """
        self.machine.add_reason("acquisition-lost", f"{sentence(description)}.", "The station restarts it.")
        self.machine.reasons.mark_outdated()
        lost = Reason(
            code="acquisition-lost",
            message="The acquisition process ended while the board was filmed; this is what had arrived.",
            action="Film the board again if the pictures do not suffice.",
        )
        for progress in self.filming:
            progress.add_fault(lost)
            if (report := progress.salvaged(self._config)) is not None:
                self._film(progress, report)
            else:
                self.memory.use(progress.run, "stitching")
                progress.advance(RunStep.FILMED)
                self.stitched(progress.run, Stitched(None))
        self.trial.acquisition_ended(description)
        self.boards.unwatched(time.monotonic(), f"{description}, and boards may have passed unnoticed")
        self.line.on_acquisition_ended(description)

    def _on_board_missed(self, report: messages.BoardMissed) -> None:
        now_s = time.monotonic()
        if why := self.line.unordered:
            action = "Film it again with its order; if boards were exchanged, arm again before the next one."
            self.boards.board_missed(replace(report, reason=why), action, now_s, code="board-without-order")
        else:
            memory = "" if self.line.has_grant else f"Memory: {self.memory.holders()}."
            self.boards.board_missed(report, memory, now_s, code="board-missed")

    def _on_run_started(self, report: messages.RunStarted) -> None:
        order = self.line.take_grant(report.run, report.host_time_s)
        if order is None:
            self.machine.add_reason("unexpected-run", f"Run {report.run} was filmed without an order.", "")
            self.contacts.missed(1, None)
            return
        bay = self.memory.use(report.run, "filming")
        self.machine.advance_if_allowed(StationStep.BOARD_ARRIVED)
        progress = self.active[report.run] = Progress.begin(report, bay, order)
        progress.came = self._came(report)
        self.contacts.began(report.run, progress.came)
        self.boards.begin(progress, edge_known=report.edge_known)
        progress.stitcher.start(self._parts.workers, lambda done: self._post(self.stitched, report.run, done))
        self._archive.begin(progress)
        self._publish(progress, f"A board of type {order.board_type.name!r} is being filmed.")
        # The next board may follow closely and needs memory at once: its bay is granted while the present bay is
        # filled.
        self.line.keep_memory_granted()

    def _came(self, report: messages.RunStarted) -> Came | None:
        """Return how the line announced a board: by contacts, by messages, or both. A bad board stays bad."""
        queue = self.line.orders.queue
        if not queue.by_messages or report.came == "failed":
            return report.came
        named = queue.board_of_run(report.run)
        return report.came if named is None else "failed" if named.failed == "bad" else "announced"

    def _on_run_finished(self, report: messages.RunFinished) -> None:
        progress = self.active.get(report.run)
        if progress is None or progress.state is not RunState.FILMING:
            return
        # The reason of a run with too many rows comes from `BoardAccount`.
        if report.reason not in WHOLE and report.reason != "max-rows":
            message = f"After row {report.head.rows - 1} nothing more was filmed: {report.reason}."
            action = "Film the board again if the pictures do not suffice."
            progress.add_fault(Reason(code="run-cut-short", message=message, action=action))
        begun, ended = self.trigger.add(report)
        for reason in begun:
            self._events.add("trouble", reason.message, run=report.run, code=reason.code, action=reason.action)
        for name in ended:
            message = f"{name[0].upper()}{name[1:]}: its frames match the pulses again."
            self._events.add("camera", message, run=report.run)
        self._film(progress, report)
        if not self.filming:
            self.machine.advance_if_allowed(StationStep.BOARD_FILMED)
            self.line.disarm_after_last_run()
            self.line.board_left()
        self.line.keep_memory_granted()

    def _on_trouble(self, report: messages.Trouble) -> None:
        reason = self.machine.reasons.trouble(report)
        if reason is not None:
            self._events.add("trouble", reason.message, code=reason.code, action=reason.action)
        if report.code == "controller-reset":
            self.contacts.controller_reset()
        if report.code in UNWATCHED:
            self.boards.unwatched(time.monotonic(), "the controller did not report all boards for a time")
        self.line.on_trouble(report)

    # --- runs

    def _film(self, progress: Progress, report: messages.RunFinished) -> None:
        self.memory.use(progress.run, "stitching")
        progress.film(report)
        self._publish(progress, f"{report.head.rows} rows were filmed.")

    def _end_in_order(self) -> None:
        """End each run that is done and before which all runs have ended."""
        # Callers use runs/next and expect boards in the order in which they passed.
        for progress in [*itertools.takewhile(lambda earlier: earlier.stitched is not None, self.active.values())]:
            self.boards.end(progress, time.monotonic())
            if progress.result is not None:
                progress.result = with_faults(progress.result, progress.faults)
            verdict = conclude(progress).status
            if progress.stitch is None or verdict is Status.FAILED:
                progress.advance(RunStep.NOT_STITCHED)
            else:
                progress.advance(RunStep.STITCHED if verdict is Status.OK else RunStep.STITCHED_WEAKLY)
            del self.active[progress.run]
            self._parts.workers.close_run(progress.run)
            self._archive.finish(progress)
            self._leaving[progress.run] = self._leaves_as_failed(progress)
            self.memory.use(progress.run, "finished")
            self.line.keep_memory_granted()
            if (job := progress.explain_job()) is not None:
                self._explaining.add(job.run)
                done, conclusion = self.explained, progress.stitcher.conclusion
                if conclusion is not None:
                    done = partial(done, again=replace(job, again=(progress.stitcher.opening, conclusion)))
                self._parts.workers.submit(job, partial(self._post, done, job))
            self._complete_stop_if_drained()

    def _leaves_as_failed(self, progress: Progress) -> bool:
        """Return whether the board of an ended run must not pass as a good one, for contacts, which name no board."""
        queue = self.line.orders.queue
        # Of a board that the messages do not name for certain, it is not known whether it is a bad one.
        unnamed = queue.by_messages and queue.board_of_run(progress.run) is None
        return progress.state is RunState.FAILED or progress.came == "failed" or unnamed

    def _complete_stop_if_drained(self) -> None:
        if not self.active and not self._explaining:
            for completion in self._stopping:
                completion.set_result(None)
            self._stopping = []

    def _publish(self, progress: Progress, message: str) -> None:
        board = {"board": progress.order.board_id} if progress.order.board_id else {}
        self._events.add("run", message, state=progress.state, run=progress.run, subject=board)
