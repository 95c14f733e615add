"""Arming and disarming: the order in force, memory granted ahead of time, and callers that wait for the line."""

from __future__ import annotations

import time
from concurrent.futures import Future
from typing import Protocol

from vaoi_station.acquisition.controller.interface import TriggerPlan
from vaoi_station.acquisition.process import messages
from vaoi_station.config import StationConfig
from vaoi_station.errors import BusyError, DeviceError, StateError
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.control import readiness
from vaoi_station.runs.control.station_state import StationStateMachine
from vaoi_station.runs.run.memory import Memory
from vaoi_station.runs.run.order import Order, Orders
from vaoi_station.runs.states.run_ids import RunIds
from vaoi_station.runs.states.schemas import Reason
from vaoi_station.runs.states.tables import RunState, RunStep, StationState, StationStep

Completion = Future[None]
"""Completed when a request has taken effect; carries the refusal otherwise."""


class Acquisition(Protocol):
    """Receiver of commands for the acquisition process."""

    def send(self, command: messages.Command) -> None:
        """Send a command; returns at once."""


class LineControl:
    """Arms and disarms the line, and keeps one bay granted to the cameras while it is armed.

    Confined to the coordinator's thread.
    """

    def __init__(
        self,
        config: StationConfig,
        acquisition: Acquisition,
        machine: StationStateMachine,
        memory: Memory,
        run_ids: RunIds,
        archive: Archive,
        events: EventLog,
    ) -> None:
        self._config, self._acquisition, self._machine = config, acquisition, machine
        self._memory, self._run_ids, self._archive, self._events = memory, run_ids, archive, events
        self.orders = Orders()
        self._granted: dict[str, int] = {}
        """Bays that the cameras hold for coming runs, by run."""
        self._arming: list[Completion] = []
        self._disarming: list[Completion] = []
        self._after_disarm: list[tuple[Order, int | None, Completion]] = []
        """Requests to arm that came while the line was being disarmed."""
        self._disarm_sent = False

    # --- requests

    def arm(self, order: Order, runs: int | None, health: messages.Health | None, completion: Completion) -> None:
        """Arm the line for an order; the completion is set once it is armed, or carries the refusal."""
        # A new Arm must not overtake the Disarm that is under way: it would be undone by it.
        if self._disarm_sent and self._machine.state in _ARMED_STATES - {StationState.FILMING}:
            self._after_disarm.append((order, runs, completion))
            return
        try:
            self._unblock()
            self._machine.require(StationStep.ARM)
            if not order.despite_lost_cameras:
                readiness.require(health, self._config.cameras)
            # Memory is claimed before the cameras are armed: with a full ring the caller is refused at once.
            if self._machine.state is StationState.IDLE:
                self._grant()
        except (StateError, BusyError, DeviceError) as refusal:
            completion.set_exception(refusal)
            return
        self.orders.accept(order, runs, time.monotonic())
        self._machine.advance(StationStep.ARM)
        self._events.add("armed", f"Armed for board type {order.board_type.name!r}.")
        if self._machine.state is StationState.ARMED:
            self.keep_memory_granted()
            completion.set_result(None)
        else:
            self._arming.append(completion)
            self._send_arm()

    def disarm(self, completion: Completion) -> None:
        """Disarm the line; the completion is set once the barrier is ignored."""
        self.orders.cancel(time.monotonic())
        if self._machine.state in _ARMED_STATES:
            self._disarming.append(completion)
            self._send_disarm()
        else:
            completion.set_result(None)

    def disarm_for_stop(self) -> None:
        """Take no more boards: the station stops."""
        self.orders.cancel(time.monotonic())
        if self._machine.state in _ARMED_STATES:
            self._send_disarm()

    def disarm_after_last_run(self) -> None:
        """Disarm the line if all boards of the order have been filmed."""
        if self.orders.order is not None and not self.orders.wants_more:
            self.orders.cancel(time.monotonic())
            self._send_disarm()

    # --- reports of the acquisition process

    def on_ready(self) -> None:
        """Return to the order that was in force before a fault, without a new request."""
        self._machine.reasons.clear()
        self._machine.advance_if_allowed(StationStep.READY)
        if self.orders.wants_more:
            self._rearm()

    def on_armed(self) -> None:
        """Complete the requests to arm."""
        # An Armed that crosses our Disarm is outdated: the Disarmed that follows decides.
        if self._machine.state is StationState.ARMING and not self._disarm_sent:
            self._machine.reasons.clear()
            self._machine.advance(StationStep.ARMED)
            for completion in self._arming:
                completion.set_result(None)
            self._arming = []
            self.keep_memory_granted()

    def on_disarmed(self, report: messages.Disarmed, health: messages.Health | None) -> None:
        """Take unused memory back, complete the requests to disarm, then serve those that waited to arm."""
        for grant in report.unused:
            self._memory.free(grant.run)
            self._granted.pop(grant.run, None)
        self._machine.reasons.drop("ring-full")
        self._machine.advance_if_allowed(StationStep.DISARMED)
        self._close_requests(StateError("The line was disarmed before it was armed."), health)

    def on_trouble(self, trouble: messages.Trouble) -> None:
        """Refuse the requests to arm: a camera or the controller cannot be armed."""
        if self._machine.state is not StationState.ARMING:
            return
        self.orders.cancel(time.monotonic())
        for completion in self._arming:
            completion.set_exception(
                DeviceError(f"Arming failed: {trouble.message}", action=trouble.action, code=trouble.code)
            )
        self._arming = []
        # Granted memory stays with the cameras until they confirm: Disarmed lists what they did not use.
        self._send_disarm()

    def on_acquisition_ended(self, description: str) -> None:
        """Take all granted memory back; no process is left that could write to it."""
        for run in self._granted:
            self._memory.free(run)
        self._granted.clear()
        self._machine.advance_if_allowed(StationStep.FAULT)
        self._close_requests(
            DeviceError(f"Arming failed: {description}.", action="The station retries automatically."), None
        )

    def take_grant(self, run: str, barrier_s: float) -> Order | None:
        """Consume the grant of a run that has started at `barrier_s`; None if no order asked for it."""
        granted = self._granted.pop(run, None)
        order = self.orders.take(barrier_s)
        return None if granted is None else order

    @property
    def has_grant(self) -> bool:
        """Whether the cameras hold memory for the next board."""
        return bool(self._granted)

    # --- memory for the next board

    def keep_memory_granted(self) -> None:
        """While boards are taken, grant memory for the next one; blocked while there is none."""
        taking = self._machine.state in _TAKING_BOARDS and not self._disarm_sent
        if not self.orders.wants_more or not taking:
            return
        try:
            self._grant()
        except BusyError as refusal:
            if self._machine.state is StationState.ARMED:
                self._machine.reasons.hold(Reason.of(refusal))
                # Without a hold the memory comes back when a stitch ends: a reason on the page, but no event.
                if self._memory.held():
                    self._events.add("trouble", refusal.message, code=refusal.code, action=refusal.action)
                self._machine.advance(StationStep.RING_FULL)
            return
        if self._machine.state is StationState.BLOCKED:
            self._machine.reasons.drop("ring-full")
            self._machine.advance(StationStep.MEMORY_FREED)

    def _unblock(self) -> None:
        """Leave the blocked state by granting memory; `BusyError` names the holders."""
        if self._machine.state is StationState.BLOCKED:
            self._grant()
            self._machine.reasons.drop("ring-full")
            self._machine.advance(StationStep.MEMORY_FREED)

    def _grant(self) -> None:
        """Give the cameras memory for a coming run unless they hold some; `BusyError` if there is none."""
        if self._granted:
            return
        granted = self._memory.grant(self._run_ids.next())
        if granted.evicted is not None:
            self._archive.mark(granted.evicted, RunStep.MEMORY_TAKEN)
            message = "Frames evicted to make room for the next board."
            self._events.add("run", message, state=RunState.GONE, run=granted.evicted)
        assert granted.bay.run is not None
        self._granted[granted.bay.run] = granted.bay.number
        self._acquisition.send(messages.Grant(granted.bay.run, granted.bay.number))

    def _rearm(self) -> None:
        try:
            self._grant()
        except BusyError as refusal:
            self._machine.add_reason(refusal.code, refusal.message, "Release runs, then arm again.")
            self.orders.cancel(time.monotonic())
            return
        self._machine.advance(StationStep.ARM)
        self._send_arm()

    def _send_arm(self) -> None:
        self._acquisition.send(messages.Arm(TriggerPlan.of(self._config.line)))

    def _send_disarm(self) -> None:
        if not self._disarm_sent:
            self._disarm_sent = True
            self._acquisition.send(messages.Disarm())

    def _close_requests(self, refusal: StateError | DeviceError, health: messages.Health | None) -> None:
        """Refuse requests to arm, complete requests to disarm, then serve those that waited: the line is disarmed."""
        self._disarm_sent = False
        arming, disarming, waiting = self._arming, self._disarming, self._after_disarm
        self._arming, self._disarming, self._after_disarm = [], [], []
        for completion in arming:
            completion.set_exception(refusal)
        for completion in disarming:
            completion.set_result(None)
        for order, runs, completion in waiting:
            self.arm(order, runs, health, completion)


_S = StationState
_ARMED_STATES = frozenset({_S.ARMING, _S.ARMED, _S.FILMING, _S.BLOCKED})
"""States in which the acquisition process has an Arm command in force."""
_TAKING_BOARDS = frozenset({_S.ARMED, _S.FILMING, _S.BLOCKED})
"""States in which the next board would be filmed, if there is memory."""
