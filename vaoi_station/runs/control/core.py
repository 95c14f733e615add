"""What the coordinator decides, in its one thread: follow the table, give memory ahead of time, restart what died."""

from __future__ import annotations

import time
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Protocol, assert_never

from vaoi_station.acquisition.controller.interface import TriggerPlan
from vaoi_station.acquisition.process import messages
from vaoi_station.config import StationConfig
from vaoi_station.errors import BusyError, DeviceError, InternalError, StateError
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.control import readiness
from vaoi_station.runs.control.active_runs import RunBook, Workers
from vaoi_station.runs.control.calibration_watch import CalibrationWatch
from vaoi_station.runs.control.reasons import Reasons
from vaoi_station.runs.run.leases import Leases
from vaoi_station.runs.run.memory import Claims, Memory
from vaoi_station.runs.run.order import Order, Orders
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.run.salvage import cut_short, film_from_pieces
from vaoi_station.runs.states.run_ids import RunIds, utc
from vaoi_station.runs.states.schemas import Reason
from vaoi_station.runs.states.tables import ADVICE, STATION, RunState, RunStep, StationState, StationStep
from vaoi_station.runs.workers.jobs import CheckJob, ConcludeJob, Job, LinkJob, Reply

Waiter = Future[None]


class Acquisition(Protocol):
    """What the coordinator needs of the link to the acquisition process."""

    def send(self, command: messages.Command) -> None:
        """Tell the process something."""


@dataclass(frozen=True)
class Parts:
    """What the coordinator conducts."""

    config: StationConfig
    ring: Claims
    acquisition: Acquisition
    workers: Workers
    archive: Archive
    events: EventLog
    run_ids: RunIds
    watch: CalibrationWatch


class Core:
    """Confined to the coordinator's thread; `InboxEvents` brings the events of other threads into it."""

    def __init__(self, parts: Parts) -> None:
        self._parts, self.watch = parts, parts.watch
        self._config, self._events, self._archive = parts.config, parts.events, parts.archive
        self.leases = Leases(parts.config.ring.lease_s)
        self.memory = Memory(parts.ring, parts.config.ring.runs, self.leases)
        self.book = RunBook(parts.workers, parts.archive, parts.events)
        self.orders = Orders()
        self.state = STATION.start
        self.since = utc()
        self.reasons = Reasons()
        self.health: messages.Health | None = None
        self.boards_missed = 0
        self._granted: dict[str, int] = {}
        """Runs the cameras hold memory for, and their bays."""
        self._arming: list[Waiter] = []
        self._disarming: list[Waiter] = []
        self._after_disarm: list[tuple[Order, int | None, Waiter]] = []
        self._disarm_sent = False
        self._stopped: list[Waiter] = []

    # --- what callers want

    def arm(self, order: Order, runs: int | None, waiter: Waiter) -> None:
        """Film boards for this order; the waiter is told when the line is armed, or why not."""
        try:
            if self._disarm_sent and self.state in _LISTENING - {StationState.FILMING}:
                self._after_disarm.append((order, runs, waiter))
                return
            self._make_room_if_blocked()
            self._may(StationStep.ARM)
            if not order.despite_lost_cameras:
                readiness.require(self.health, self._config.cameras)
            if self.state is StationState.IDLE:
                self._grant()
        except (StateError, BusyError, DeviceError) as refusal:
            waiter.set_exception(refusal)
            return
        self.orders.accept(order, runs, time.monotonic())
        self._step(StationStep.ARM)
        self._tell("armed", f"Boards are taken for board type {order.board_type.name!r}.")
        if self.state is StationState.ARMED:
            self._provide()
            waiter.set_result(None)
        else:
            self._arming.append(waiter)
            self._parts.acquisition.send(messages.Arm(TriggerPlan.of(self._config.line)))

    def disarm(self, waiter: Waiter) -> None:
        """Ignore the barrier; the waiter is told when that is so."""
        self.orders.cancel(time.monotonic())
        if self.state in _LISTENING:
            self._disarming.append(waiter)
            self._send_disarm()
        else:
            waiter.set_result(None)

    def release(self, run: str) -> None:
        """Give a finished run's frames up, whoever holds them."""
        if run in self.book.active:
            raise StateError(
                f"Run {run} is {self.book.active[run].state}; its memory is needed.", action="Wait for its result."
            )
        self._archive.mark(run, RunStep.RELEASE)
        self.memory.free(run)
        self._tell("run", "Its frames were released.", state=RunState.RELEASED, run=run)
        self._provide()

    def let_go(self, run: str, holder: str) -> None:
        """A lease ends; its run's memory may be what the next board waits for."""
        self.leases.end(run, holder)
        self._provide()

    def stop(self, waiter: Waiter) -> None:
        """No more boards; the waiter is told when the runs under way have ended."""
        self.orders.cancel(time.monotonic())
        if self.state in _LISTENING:
            self._send_disarm()
        self._step(StationStep.STOP)
        self._stopped.append(waiter)
        self._tell_if_drained()

    # --- what the acquisition process says

    def acquisition_message(self, message: messages.Report) -> None:
        """Process a message of the acquisition process."""
        match message:
            case messages.PulseReported():
                self.book.pulse(message)
            case messages.FrameSettled():
                self.book.settle(message)
            case messages.RunStarted():
                self._on_run_started(message)
            case messages.RunFinished():
                self._on_run_finished(message)
            case messages.Health():
                self._on_health(message)
            case messages.Trouble():
                self._on_trouble(message)
            case messages.BoardMissed():
                self._on_board_missed(message)
            case messages.Armed():
                self._on_armed()
            case messages.Disarmed():
                self._on_disarmed(message)
            case messages.Ready():
                self._on_ready()
            case _:
                assert_never(message)

    def worker_reply(self, job: Job, answer: Reply, at_s: float) -> None:
        """Process the outcome of a job that arrived at `at_s`, by time.monotonic()."""
        match job:
            case LinkJob():
                self._after_runs(self.book.linked(job, answer, at_s))
            case ConcludeJob():
                self._after_runs(self.book.concluded(job, answer, at_s))
            case CheckJob():
                self.watch.checked(job, answer)
            case _:
                raise InternalError(f"Nothing waits for the answer of {job}.")

    def acquisition_ended(self, sentence: str) -> None:
        """The process has died: conclude what it filmed, take its memory back; it is being restarted."""
        self._blame("acquisition-lost", f"{sentence[0].upper()}{sentence[1:]}.", "It is being started again.")
        self.reasons.begin_anew()
        for progress in self.book.filming:
            self._salvage(progress)
        for run in self._granted:
            self.memory.free(run)
        self._granted.clear()
        self.health, self._disarm_sent = None, False
        self._try(StationStep.FAULT)
        for waiter in self._arming:
            waiter.set_exception(DeviceError(f"Arming failed: {sentence}.", action="It is tried again by itself."))
        for waiter in self._disarming:
            waiter.set_result(None)
        self._arming, self._disarming = [], []
        self._arm_those_who_waited()

    def worker_ended(self, description: str) -> None:
        """Log the end of a worker; the pool restarts it."""
        self._tell("process", description)

    def workers_ready(self) -> None:
        """Log that all workers are ready."""
        self._tell("workers", "The workers are ready: results come at once.")

    def tick(self) -> None:
        """Twice a second: leases nobody renewed end."""
        for lease in self.leases.expire():
            self._tell("lease", f"The hold of {lease.holder} ({lease.purpose}) expired.", run=lease.run)
        if self.state not in _IN_TROUBLE:
            self.reasons.expire()
        self._provide()

    def _on_ready(self) -> None:
        self.reasons.clear()
        self._try(StationStep.READY)
        if self.orders.wants_more:
            self._rearm()

    def _on_armed(self) -> None:
        if self.state is StationState.ARMING and not self._disarm_sent:
            self.reasons.clear()
            self._step(StationStep.ARMED)
            for waiter in self._arming:
                waiter.set_result(None)
            self._arming = []
            self._provide()

    def _on_disarmed(self, report: messages.Disarmed) -> None:
        for grant in report.unused:
            self.memory.free(grant.run)
            self._granted.pop(grant.run, None)
        self._disarm_sent = False
        self.reasons.drop("ring-full")
        self._try(StationStep.DISARMED)
        for waiter in self._arming:
            waiter.set_exception(StateError("The line was disarmed before it was armed."))
        for waiter in self._disarming:
            waiter.set_result(None)
        self._arming, self._disarming = [], []
        self._arm_those_who_waited()

    def _on_run_started(self, report: messages.RunStarted) -> None:
        granted = self._granted.pop(report.run, None)
        order = self.orders.take(report.host_time_s)
        if order is None or granted is None:
            self._blame("unexpected-run", f"Run {report.run} was filmed, but nobody asked for it.", "")
            return
        bay = self.memory.use(report.run, "filming")
        self._try(StationStep.BOARD_ARRIVED)
        self.book.open(Progress.begin(report, bay, order))
        self._provide()

    def _on_run_finished(self, report: messages.RunFinished) -> None:
        if report.run not in self.book.active:
            return
        self.memory.use(report.run, "stitching")
        if (reason := cut_short(report)) is not None:
            self.book.active[report.run].blame(reason)
        self._after_runs(self.book.filmed(report))
        if not self.book.filming:
            self._try(StationStep.BOARD_FILMED)
            if self.orders.order is not None and not self.orders.wants_more:
                self.orders.cancel(time.monotonic())
                self._send_disarm()
        self._provide()

    def _on_board_missed(self, report: messages.BoardMissed) -> None:
        self.boards_missed += 1
        self._events.add(
            "board-missed",
            f"A board passed and was not filmed: {report.reason}",
            code="board-missed",
            action=f"Memory: {self.memory.holders()}." if not self._granted else "",
        )

    def _on_health(self, report: messages.Health) -> None:
        for change in readiness.changes(self.health, report, self._config.cameras):
            self._tell("camera", change)
        self.health = report

    def _on_trouble(self, report: messages.Trouble) -> None:
        reason = self.reasons.trouble(report)
        if reason is not None:
            self._events.add("trouble", reason.message, code=reason.code, action=reason.action)
        if self.state is StationState.ARMING:
            self._fail_arming(report)

    # --- how it goes about it

    def _grant(self) -> None:
        """Give the cameras memory for a coming run, unless they hold some; `BusyError` if there is none."""
        if self._granted:
            return
        granted = self.memory.grant(self._parts.run_ids.next())
        if granted.evicted is not None:
            self._archive.mark(granted.evicted, RunStep.MEMORY_TAKEN)
            self._tell("run", "Its frames made room.", state=RunState.GONE, run=granted.evicted)
        assert granted.bay.run is not None
        self._granted[granted.bay.run] = granted.bay.number
        self._parts.acquisition.send(messages.Grant(granted.bay.run, granted.bay.number))

    def _provide(self) -> None:
        """While armed, have memory ready for the next board; blocked while there is none."""
        if not self.orders.wants_more or self.state not in _WATCHING or self._disarm_sent:
            return
        try:
            self._grant()
        except BusyError as refusal:
            if self.state is StationState.ARMED:
                self.reasons.hold(Reason.of(refusal))
                if self.memory.held():
                    self._events.add("trouble", refusal.message, code=refusal.code, action=refusal.action)
                self._step(StationStep.RING_FULL)
            return
        if self.state is StationState.BLOCKED:
            self.reasons.drop("ring-full")
            self._step(StationStep.MEMORY_FREED)

    def _make_room_if_blocked(self) -> None:
        """Blocked is not wrong, only full: a caller is told who holds the memory."""
        if self.state is StationState.BLOCKED:
            self._grant()
            self.reasons.drop("ring-full")
            self._step(StationStep.MEMORY_FREED)

    def _rearm(self) -> None:
        """Go on as before the fault, without anybody asking."""
        try:
            self._grant()
        except BusyError as refusal:
            self._blame(refusal.code, refusal.message, "Release runs, then arm again.")
            self.orders.cancel(time.monotonic())
            return
        self._step(StationStep.ARM)
        self._parts.acquisition.send(messages.Arm(TriggerPlan.of(self._config.line)))

    def _fail_arming(self, trouble: messages.Trouble) -> None:
        """The cameras or the controller cannot; memory comes back with the answer to the disarming."""
        self.orders.cancel(time.monotonic())
        for waiter in self._arming:
            waiter.set_exception(
                DeviceError(f"Arming failed: {trouble.message}", action=trouble.action, code=trouble.code)
            )
        self._arming = []
        self._send_disarm()

    def _arm_those_who_waited(self) -> None:
        waiting, self._after_disarm = self._after_disarm, []
        for order, runs, waiter in waiting:
            self.arm(order, runs, waiter)

    def _send_disarm(self) -> None:
        if not self._disarm_sent:
            self._disarm_sent = True
            self._parts.acquisition.send(messages.Disarm())

    def _salvage(self, progress: Progress) -> None:
        """A run whose second half never came."""
        reason = Reason(
            code="acquisition-lost",
            message="The acquisition process ended while the board was filmed; this is what had arrived.",
            action="Film the board again if the pictures do not suffice.",
        )
        progress.blame(reason)
        self.memory.use(progress.run, "stitching")
        film = film_from_pieces(progress, self._config)
        if film is not None:
            self._after_runs(self.book.filmed(film))
        else:
            progress.step(RunStep.FILMED)
            self._after_runs(self.book.give_up(progress, reason))

    def _after_runs(self, ended: list[Progress]) -> None:
        for progress in ended:
            self.memory.use(progress.run, "finished")
            self.watch.check(progress, self._parts.workers)
            self._provide()
            self._tell_if_drained()

    def _tell_if_drained(self) -> None:
        if not self.book.active:
            for waiter in self._stopped:
                waiter.set_result(None)
            self._stopped = []

    def _may(self, event: StationStep) -> None:
        """`StateError` with the reason the station has for its state."""
        if not STATION.allows(self.state, event):
            reason = next(iter(self.reasons.all()), None)
            why = f" ({reason.message})" if reason else ""
            message = f"The station is {self.state}{why}; {event!s} is not possible now."
            raise StateError(message, action=ADVICE.get(self.state, ""))

    def _step(self, event: StationStep) -> None:
        state = STATION.next(self.state, event)
        if state is not self.state:
            self.state, self.since = state, utc()
            self._tell("station", f"The station is {state}.", state=state)

    def _try(self, event: StationStep) -> None:
        """Follow the table if it knows the event here; devices may report late what no longer matters."""
        if STATION.allows(self.state, event):
            self._step(event)

    def _blame(self, code: str, message: str, action: str) -> None:
        if self.reasons.hold(Reason(code=code, message=message, action=action)):
            self._events.add("trouble", message, code=code, action=action)

    def _tell(self, kind: str, message: str, *, state: str = "", run: str | None = None) -> None:
        self._events.add(kind, message, state=state, run=run)


_S = StationState
_LISTENING = frozenset({_S.ARMING, _S.ARMED, _S.FILMING, _S.BLOCKED})
"""States in which the acquisition process has been told to arm."""
_IN_TROUBLE = frozenset({_S.FAULTED, _S.ARMING})
"""States in which the reasons are what a caller waits for."""
_WATCHING = frozenset({_S.ARMED, _S.FILMING, _S.BLOCKED})
