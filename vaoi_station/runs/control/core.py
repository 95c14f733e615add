"""The decisions of the coordinator's thread: how the station reacts to requests, reports of processes and ticks."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass
from functools import partial
from typing import assert_never

from vaoi_station.acquisition.process import messages
from vaoi_station.config import StationConfig
from vaoi_station.errors import StateError, VaoiError
from vaoi_station.model import Reason
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.control import readiness
from vaoi_station.runs.control.active_runs import ActiveRuns, Workers, early_end_reason, salvage_recording
from vaoi_station.runs.control.calibration_watch import CalibrationWatch
from vaoi_station.runs.control.line_control import Acquisition, Completion, LineControl
from vaoi_station.runs.control.readiness import LinePermit
from vaoi_station.runs.control.reasons import StationStateMachine, sentence
from vaoi_station.runs.lighting.trials import CameraTrial
from vaoi_station.runs.run.boards import UNWATCHED, BoardAccount, TriggerWatch
from vaoi_station.runs.run.memory import BayRing, Leases, Memory
from vaoi_station.runs.run.order import Order, Passing, Resumed, StandingOrder
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.states.run_ids import RunIds
from vaoi_station.runs.states.tables import RunState, RunStep, StationState, StationStep
from vaoi_station.runs.workers.jobs import CheckJob, ConcludeJob, LinkJob, Reply


@dataclass(frozen=True)
class Parts:
    """The objects with which the coordinator works, such as the archive and the workers."""

    config: StationConfig
    ring: BayRing
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


class Core:
    """Decides how the station reacts to requests, reports of processes and ticks.

    It is used by the coordinator's thread only, to which reports and replies of other threads are posted.
    """

    def __init__(self, parts: Parts, post: Callable[..., object] = lambda work, *args: work(*args)) -> None:
        """Connect the parts. `post` lets the coordinator's thread call a function with arguments."""
        self._post = post
        self._parts, self.watch, self.storage = parts, parts.watch, parts.archive.storage
        self._config, self._events, self._archive = parts.config, parts.events, parts.archive
        self.other_warnings = parts.other_warnings
        self.leases = Leases(parts.config.ring.lease_s)
        self.memory = Memory(parts.ring, parts.config.ring.runs, self.leases)
        parts.archive.keep_s = parts.config.ring.keep_s
        self.machine = StationStateMachine(parts.events)
        self.line = LineControl(
            parts.config,
            parts.acquisition,
            self.machine,
            self.memory,
            parts.run_ids,
            parts.archive,
            parts.events,
            parts.standing,
        )
        if parts.resumed is not None:
            self.line.resume(parts.resumed)
        self.boards = BoardAccount(parts.config.line, self.line.orders, parts.events.add)
        self.runs = ActiveRuns(
            parts.workers,
            self._submit,
            parts.archive,
            parts.events,
            lambda run: self.boards.end(run, time.monotonic()),
        )
        self.health: messages.Health | None = None
        self.trigger = TriggerWatch([camera.label for camera in parts.config.cameras])
        interlocked = parts.config.controller.interlock == "on"
        self.permit = LinePermit(parts.acquisition.send if interlocked else None, parts.events.add)
        self._stopping: list[Completion] = []
        on_evicted = partial(self.line.evicted, room_for="a trial of a camera")
        self.trial = CameraTrial(parts.acquisition, lambda: self.machine.state, self.memory, on_evicted)

    # --- requests of callers

    def arm(self, order: Order, runs: int | None, completion: Completion, passing: Passing = "wait") -> int:
        """Arm the line. The completion is set once the order is in force, or carries the refusal.

        Returns for how many things the caller waits in turn: a board that passes, then cameras and controller. 0: the
        order takes effect when the board has left, and the caller does not wait for it.
        """
        board_passes = self.machine.state is StationState.FILMING
        if board_passes and passing == "refuse":
            self.machine.require(StationStep.ARM)
        later = board_passes and passing == "after"
        completion.add_done_callback(partial(self._report_order, order, later))
        self.line.arm(order, runs, self.health, completion)
        return 0 if later else 2 if board_passes else 1

    def _report_order(self, order: Order, later: bool, completion: Completion) -> None:
        """Publish the notes of an order that is in force, and why one did not take effect if no caller waits for it."""
        refusal = completion.exception()
        if refusal is None:
            for note in order.notes:
                self._events.add("trouble", note.message, code=note.code, action=note.action)
        elif later and isinstance(refusal, VaoiError):
            message = f"The order given while a board passed did not take effect: {refusal.message}"
            self._events.add("trouble", message, code=refusal.code, action=refusal.action)

    def withdraw(self, completion: Completion) -> bool:
        """Withdraw a request to arm that waits until a board has passed. Return False if it does not wait any more."""
        return self.line.withdraw(completion)

    def disarm(self, completion: Completion) -> None:
        """Disarm the line. The completion is set once the acquisition process ignores the barrier."""
        self.line.disarm(completion)

    def release(self, run: str, holder: str | None = None) -> None:
        """Give up the frames of a finished run, and end the hold of `holder`; `StateError` if another one holds it."""
        if run in self.runs.active:
            raise StateError(
                f"Run {run} is {self.runs.active[run].state}; its memory is needed.", action="Wait for its result."
            )
        if others := [lease for lease in self.leases.of_callers(run) if lease.holder != holder]:
            names = ", ".join(map(str, others))
            left_s = max(self.leases.remaining_s(lease) for lease in others)
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
        self.leases.end(run, holder)
        self.line.keep_memory_granted()

    def announced(self, run: str, until_s: float) -> None:
        """Keep the frames of a run that was announced until a host time, unless they are released before."""
        self.memory.keep(run, until_s)
        self.line.keep_memory_granted()

    def stop(self, completion: Completion) -> None:
        """Take no more boards. The completion is set when all unfinished runs have ended."""
        self.line.disarm_for_stop()
        self.machine.advance(StationStep.STOP)
        self._stopping.append(completion)
        self._complete_stop_if_drained()

    def devices(self) -> messages.Health | None:
        """Return the latest report of the devices; None while there is none."""
        return self.health

    def tick(self) -> None:
        """Remove expired leases and troubles, and try to grant memory again. The inbox calls this every tick."""
        for lease in self.leases.expire():
            self._events.add("lease", f"The hold of {lease} expired.", run=lease.run)
        # In the states FAULTED and ARMING, callers need the reasons to act: reasons stay until the state changes.
        if self.machine.state not in (StationState.FAULTED, StationState.ARMING):
            self.machine.reasons.expire()
        for run in self.memory.reclaim(self.runs.active):
            self._events.add("trouble", "The run ended by a fault; its memory is free again.", run=run, code="store")
        self.line.tick(self.health)
        self.line.keep_memory_granted()
        self._archive.tick()
        self.trial.tick()

    # --- reports of the workers

    def worker_reply(self, job: LinkJob | ConcludeJob | CheckJob, reply: Reply, at_s: float) -> None:
        """Give a worker's reply to the run of its job. `at_s` is the time of its arrival by time.monotonic()."""
        match job:
            case LinkJob():
                self._after_runs(self.runs.linked(job, reply, at_s))
            case ConcludeJob():
                self._after_runs(self.runs.concluded(job, reply, at_s))
            case CheckJob():
                self.watch.checked(job, reply)

    def _submit(self, job: LinkJob | ConcludeJob | CheckJob) -> None:
        """Queue a job; its reply comes to `worker_reply`."""

        def done(reply: Reply) -> None:
            self._post(self.worker_reply, job, reply, time.monotonic())

        self._parts.workers.submit(job, done)

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
                self.runs.settle(message)
            case messages.PulseReported():
                self.runs.pulse(message)
            case messages.Health():
                self._on_health(message)
            case messages.RunStarted():
                self._on_run_started(message)
            case messages.RunFinished():
                self._on_run_finished(message)
            case messages.Trouble():
                self._on_trouble(message)
            case messages.BoardMissed():
                memory = "" if self.line.has_grant else f"Memory: {self.memory.holders()}."
                self.boards.board_missed(message, memory, time.monotonic())
            case messages.MissedPassage():
                self.boards.passage_missed(message, time.monotonic())
            case messages.Armed():
                self.line.on_armed()
            case messages.Disarmed():
                self.line.on_disarmed(message, self.health)
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
        for progress in self.runs.filming:
            self._salvage(progress)
        self.health = None
        self.trial.acquisition_ended(description)
        self.boards.unwatched(time.monotonic(), f"{description}, and boards may have passed unnoticed")
        self.line.on_acquisition_ended(description)

    def _on_run_started(self, report: messages.RunStarted) -> None:
        order = self.line.take_grant(report.run, report.host_time_s)
        if order is None:
            self.machine.add_reason("unexpected-run", f"Run {report.run} was filmed without an order.", "")
            return
        bay = self.memory.use(report.run, "filming")
        self.machine.advance_if_allowed(StationStep.BOARD_ARRIVED)
        progress = Progress.begin(report, bay, order)
        self.boards.begin(progress, self.line.orders.taken_since_s, edge_known=report.edge_known)
        self.runs.open(progress)
        # The next board may follow closely and needs memory at once: its bay is granted while the present bay is
        # filled.
        self.line.keep_memory_granted()

    def _on_run_finished(self, report: messages.RunFinished) -> None:
        if report.run not in self.runs.active:
            return
        self.memory.use(report.run, "stitching")
        if (reason := early_end_reason(report)) is not None:
            self.runs.active[report.run].add_fault(reason)
        self._watch_trigger(report)
        self._after_runs(self.runs.filmed(report))
        if not self.runs.filming:
            self.machine.advance_if_allowed(StationStep.BOARD_FILMED)
            self.line.disarm_after_last_run()
            self.line.board_left(self.health)
        self.line.keep_memory_granted()

    def _watch_trigger(self, report: messages.RunFinished) -> None:
        """Publish the warnings about frames in doubt that begin with this run, and those that end with it."""
        begun, ended = self.trigger.add(report)
        for reason in begun:
            self._events.add("trouble", reason.message, run=report.run, code=reason.code, action=reason.action)
        for name in ended:
            self._events.add(
                "camera", f"{name[0].upper()}{name[1:]}: its frames match the pulses again.", run=report.run
            )

    def _on_health(self, report: messages.Health) -> None:
        for change in readiness.changes(self.health, report, self._config.cameras):
            self._events.add("camera", change)
        self.health = report

    def _on_trouble(self, report: messages.Trouble) -> None:
        reason = self.machine.reasons.trouble(report)
        if reason is not None:
            self._events.add("trouble", reason.message, code=reason.code, action=reason.action)
        if report.code in UNWATCHED:
            self.boards.unwatched(time.monotonic(), "the controller did not report all boards for a time")
        self.line.on_trouble(report)

    # --- runs

    def _salvage(self, progress: Progress) -> None:
        """Stitch a run from the frames that had arrived when the acquisition process ended."""
        reason = Reason(
            code="acquisition-lost",
            message="The acquisition process ended while the board was filmed; this is what had arrived.",
            action="Film the board again if the pictures do not suffice.",
        )
        progress.add_fault(reason)
        self.memory.use(progress.run, "stitching")
        report = salvage_recording(progress, self._config)
        if report is not None:
            self._after_runs(self.runs.filmed(report))
        else:
            progress.advance(RunStep.FILMED)
            self._after_runs(self.runs.give_up(progress, reason))

    def _after_runs(self, ended: list[Progress]) -> None:
        """Allow eviction of ended runs, grant memory to the next board, and complete requests to stop."""
        for progress in ended:
            self.memory.use(progress.run, "finished")
            self.line.keep_memory_granted()
            self._complete_stop_if_drained()

    def _complete_stop_if_drained(self) -> None:
        if not self.runs.active:
            for completion in self._stopping:
                completion.set_result(None)
            self._stopping = []
