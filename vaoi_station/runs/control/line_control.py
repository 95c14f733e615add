"""Arming and disarming of the line: the order in force, the memory granted for the next board, and waiting callers."""

from __future__ import annotations

import logging
import time
from concurrent.futures import Future
from functools import partial
from typing import NamedTuple, Protocol

from vaoi_station.acquisition.controller.interface import TriggerPlan
from vaoi_station.acquisition.process import messages
from vaoi_station.backoff import Backoff, BackoffPolicy
from vaoi_station.config import StationConfig
from vaoi_station.errors import BusyError, DeviceError, StateError, VaoiError
from vaoi_station.model import Reason
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.control import readiness
from vaoi_station.runs.control.reasons import StationStateMachine
from vaoi_station.runs.run.memory import Memory
from vaoi_station.runs.run.order import Order
from vaoi_station.runs.run.order_queue import OrderQueue
from vaoi_station.runs.run.orders import Orders
from vaoi_station.runs.run.standing_order import Resumed, StandingOrder
from vaoi_station.runs.states.run_ids import RunIds
from vaoi_station.runs.states.schemas import ArmedWith
from vaoi_station.runs.states.tables import RunState, RunStep, StationState, StationStep

_log = logging.getLogger(__name__)

PACE = BackoffPolicy(first_s=2.0, longest_s=30.0, proven_s=30.0)
"""Pauses between attempts of the station to arm the line again by itself."""
_ARMED_WHEN_FREE = "Release runs, or wait: the line is armed again as soon as memory is free."
_S = StationState
_ARMED_STATES = frozenset({_S.ARMING, _S.ARMED, _S.FILMING, _S.BLOCKED})
"""States in which the acquisition process has an Arm command in force."""
_WITH_PLAN = frozenset({_S.ARMED, _S.BLOCKED})
"""States in which the controller waits for a board with the plan that was armed."""
_TAKING_BOARDS = frozenset({_S.ARMED, _S.FILMING, _S.BLOCKED})
"""States in which the next board is filmed if memory is free for it."""

Completion = Future[None]
"""A future that is set when a request has taken effect, or carries the refusal of the request."""


class Acquisition(Protocol):
    """The acquisition process, to which commands are sent."""

    def send(self, command: messages.Command) -> None:
        """Send a command, without waiting for its effect."""

    def forget(self) -> None:
        """Give up the commands that were not sent yet, because the process has ended."""


class _Request(NamedTuple):
    """A request to arm for an order, None: for those that wait; `runs` is the number of boards to film, None: all."""

    order: Order | None
    runs: int | None
    completion: Completion
    asked_s: float
    """When its caller knew of all boards that had been reported."""


class LineControl:
    """Arms and disarms the line. Used by the coordinator's thread only.

    While the line is armed, the cameras hold a bay for the next board, unless no bay is free. Of several requests that
    wait for the same, the newest order is put in force, and their callers receive the same reply: if each was put in
    force in turn, the order of a board that is already at the barrier would be forgotten.
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
        standing: StandingOrder | None = None,
    ) -> None:
        self._config, self._acquisition, self._machine = config, acquisition, machine
        self._memory, self._run_ids, self._archive, self._events = memory, run_ids, archive, events
        self._standing, self.orders = standing, Orders(queue=OrderQueue(config.line.transport_s))
        self._set_for: Order | None = None
        """The order for which cameras and controller were set, and memory was granted last."""
        self.health: messages.Health | None = None
        """The latest report of the devices; None while there is none."""
        self._granted: dict[str, int] = {}
        """Numbers of the bays that the cameras hold for coming runs, by run id."""
        self._arming: list[Completion] = []
        self._disarming: list[Completion] = []
        self._after_board: list[_Request] = []
        """Requests that wait until the board that passes, which keeps the order before, has left."""
        self._after_disarm: list[_Request] = []
        """Requests that wait until the line is disarmed, because the Disarm under way would undo them."""
        self._disarm_sent = False
        self.plan: TriggerPlan | None = None
        """The trigger plan of the newest Arm command."""
        self.times_blocked = 0
        """Number of times that the armed line had no memory for the next board."""
        self._setting_since_s: float | None = None
        """Time since which the line is disarmed to set it for the next order; None if it is not."""
        self._rearm_pace = Backoff(PACE)
        self._not_armed_again: Reason | None = None
        """Why the line is not armed again after a restart or a fault."""

    # --- requests

    def resume(self, resumed: Resumed) -> None:
        """Put the order from before the restart in force; the line is armed as soon as the devices are open."""
        now_s = time.monotonic()
        self.orders.queue.resume(resumed.waiting, now_s)
        self._not_armed_again = resumed.fault
        for fault in (*resumed.lost, *((resumed.fault,) if resumed.fault is not None else ())):
            self._events.add("trouble", fault.message, code=fault.code, action=fault.action)
        if resumed.order is None and not resumed.by_orders:
            return
        self.orders.accept(resumed.order, resumed.runs, now_s)
        self.orders.resumed = True
        self.orders.doubt(now_s, now_s, "the station was restarted, and boards may have passed unnoticed")
        self._events.add("armed", f"{_armed_for(resumed.order, 'again ')}, as before the restart.", code="armed-again")

    def arm(self, order: Order | None, runs: int | None, completion: Completion, asked_s: float | None = None) -> None:
        """Arm the line for an order and a number of boards (None: no limit); without one, for the orders that wait.

        The completion is set once the line is armed, or carries the refusal. `asked_s` is when it was asked for; None:
        now.
        """
        asked_s = time.monotonic() if asked_s is None else asked_s
        request, state = _Request(order, runs, completion, asked_s), self._machine.state
        first = self.orders.queue.next(order)
        if self._disarm_sent and state in _ARMED_STATES:
            self._after_disarm.append(request)
            return
        if state is StationState.FILMING:
            self._after_board.append(request)
            return
        try:
            if state in _WITH_PLAN and self._plan_of(first) != self.plan:
                self._require_cameras(first)
                # Cameras and controller take another plan only when they are disarmed. If they end meanwhile, the order
                # in force is armed again.
                self._after_disarm.append(request)
                self._send_disarm()
                self._setting_since_s = asked_s
                return
            if state is StationState.BLOCKED and first is not None:
                self._grant()
                self._machine.reasons.drop("ring-full")
                self._machine.advance(StationStep.MEMORY_FREED)
            self._machine.require(StationStep.ARM)
            self._require_cameras(first)
            # Memory is granted before the cameras are armed, so that a full ring refuses the caller at once.
            if state is StationState.IDLE and first is not None:
                self._grant()
        except (StateError, BusyError, DeviceError) as refusal:
            completion.set_exception(refusal)
            return
        self.orders.accept(order, runs, time.monotonic(), asked_s)
        if order is not None:
            # Who arms for a board type holds boards back until the reply.
            self._setting_since_s = None
        self._keep_order()
        self._machine.advance(StationStep.ARM)
        self._events.add("armed", f"{_armed_for(order)}.")
        if self._machine.state is StationState.ARMED:
            self.keep_memory_granted()
            completion.set_result(None)
        else:
            self._arming.append(completion)
            self._send_arm()

    def withdraw(self, completion: Completion) -> bool:
        """Withdraw a request to arm that waits until a board has passed. Return False if it does not wait any more."""
        kept = [request for request in self._after_board if request.completion is not completion]
        waited, self._after_board = len(kept) < len(self._after_board), kept
        return waited

    def board_left(self) -> None:
        """Serve the requests to arm that waited until the boards at the barrier had passed."""
        waiting, self._after_board = self._after_board, []
        self._serve(waiting)
        self.follow()

    def follow(self) -> None:
        """Keep the orders that wait, and set cameras and controller for the next one, unless a board is passing."""
        self._keep_waiting()
        order = self.orders.next
        if order is not None and self._machine.state in _WITH_PLAN and self._plan_of(order) != self.plan:
            # It is armed again as soon as it is disarmed.
            self._send_disarm()
            self._setting_since_s = time.monotonic()
        self.keep_memory_granted()

    @property
    def next_order(self) -> ArmedWith | None:
        """The order that takes effect when the board that passes has left; None if there is none."""
        newest = self._after_board[-1] if self._after_board else None
        return None if newest is None or newest.order is None else newest.order.shown(newest.runs)

    def disarm(self, completion: Completion) -> None:
        """Disarm the line. The completion is set once the acquisition process ignores the barrier."""
        # An order that was given before the disarm must not arm the line after it.
        for request in [*self._after_board, *self._after_disarm]:
            request.completion.set_exception(StateError("The line was disarmed before it was armed."))
        self._after_board, self._after_disarm, self._setting_since_s = [], [], None
        self.orders.cancel(time.monotonic())
        self._keep_order()
        if self._machine.state in _ARMED_STATES:
            self._disarming.append(completion)
            self._send_disarm()
        else:
            self._machine.reasons.drop("ring-full")
            completion.set_result(None)

    def disarm_for_stop(self) -> None:
        """Disarm the line because the station stops; no caller waits for it. The next start arms it again."""
        self.orders.cancel(time.monotonic())
        if self._machine.state in _ARMED_STATES:
            self._send_disarm()

    def disarm_after_last_run(self) -> None:
        """Disarm the line if all boards of the order have been filmed."""
        if self.orders.order is not None and not self.orders.wants_more:
            self.orders.cancel(time.monotonic())
            self._keep_order()
            self._send_disarm()

    # --- reports of the acquisition process

    def on_ready(self) -> None:
        """Handle the report that the devices are open. An order from before a fault is armed again automatically."""
        self._machine.reasons.clear()
        self._machine.advance_if_allowed(StationStep.READY)
        if self.orders.wants_more:
            self._rearm()

    def on_armed(self) -> None:
        """Handle the report that the line is armed: set the completions of the waiting requests to arm."""
        # An Armed message that arrives after a Disarm was sent is outdated: the Disarmed message that follows decides.
        if self._machine.state is StationState.ARMING and not self._disarm_sent:
            self._machine.reasons.clear()
            self._machine.advance(StationStep.ARMED)
            self._rearm_pace.reset()
            self._set_again()
            if self._not_armed_again is not None:
                self._not_armed_again = None
                self._events.add("armed", "Armed again: what was against it is over.", code="armed-again")
            for completion in self._arming:
                completion.set_result(None)
            self._arming = []
            self.keep_memory_granted()

    def on_disarmed(self, report: messages.Disarmed) -> None:
        """Handle the report that the line is disarmed: take unused memory back, and complete the requests."""
        for grant in report.unused:
            self._memory.free(grant.run)
            self._granted.pop(grant.run, None)
        self._machine.reasons.drop("ring-full")
        self._machine.advance_if_allowed(StationStep.DISARMED)
        self._close_requests(StateError("The line was disarmed before it was armed."))
        if self._setting_since_s is not None:
            self.tick()

    def on_trouble(self, trouble: messages.Trouble) -> None:
        """Handle a trouble during arming: refuse the waiting requests to arm, or try again later without a caller."""
        if self._machine.state is not StationState.ARMING or self._disarm_sent:
            return
        if self._arming:
            self.orders.cancel(time.monotonic())
            self._keep_order()
        else:
            # No caller waits: the station itself is arming the line again. The order stays in force.
            self._note_not_armed(trouble.message, trouble.action)
            self._rearm_pace.record_failure()
        for completion in self._arming:
            message = f"Arming failed: {trouble.message}"
            completion.set_exception(DeviceError(message, action=trouble.action, code=trouble.code))
        self._arming = []
        # The cameras keep granted memory until they confirm the Disarm: the Disarmed message lists the bays not used.
        self._send_disarm()

    def on_acquisition_ended(self, description: str) -> None:
        """Take back all granted memory, to which no process can write now, and refuse the waiting requests to arm."""
        self.health = None
        self._acquisition.forget()
        for run in self._granted:
            self._memory.free(run)
        self._granted.clear()
        self._machine.advance_if_allowed(StationStep.FAULT)
        self._close_requests(DeviceError(f"Arming failed: {description}.", action="The station retries automatically."))

    def take_grant(self, run: str, barrier_s: float) -> Order | None:
        """Consume the grant of a run whose board met the barrier at `barrier_s`; return its order.

        None if no memory was granted to the run.
        """
        granted = self._granted.pop(run, None)
        order = self.orders.take(barrier_s, run, self._set_for)
        if order is not None and self._plan_of(order) != self.plan:
            why = f"it came before cameras and controller were set for board type {order.board_type.name!r}"
            order = self.orders.disown(run, self._set_for, why, time.monotonic())
        if self.orders.runs_left is not None:
            self._keep_order()
        self._keep_waiting()
        return None if granted is None else order

    @property
    def unordered(self) -> str:
        """Why no board is to be filmed now although the line is armed; empty if one is."""
        order = self.orders.next
        if not self.orders.armed or (order is not None and self._plan_of(order) == self.plan):
            return ""
        return "no order waited for it" if order is None else "cameras and controller were not set for its order yet"

    @property
    def has_grant(self) -> bool:
        """Whether the cameras hold a bay for the next board."""
        return bool(self._granted)

    @property
    def expects_board(self) -> bool:
        """Whether the cameras hold a bay for the next board, and the line is not being disarmed."""
        return bool(self._granted) and not self._disarm_sent

    # --- memory for the next board

    def keep_memory_granted(self) -> None:
        """Grant a bay for the next board while the line takes boards.

        If no bay is free, an armed line becomes blocked, and a line that films shows the reason at once. A blocked line
        becomes armed again when a bay is granted.
        """
        taking = self._machine.state in _TAKING_BOARDS and not self._disarm_sent
        order = self.orders.next
        # A board that follows closely must not be filmed as the order of the board before it.
        if order is None or not taking or self._plan_of(order) != self.plan:
            return
        self._set_for = order
        try:
            self._grant()
        except BusyError as refusal:
            # The reason is set again at every call, because its message names the present use of the memory.
            self._machine.reasons.hold(Reason.of(refusal))
            if self._machine.state is StationState.ARMED:
                self.times_blocked += 1
                # If no run is held or kept, memory becomes free as soon as a stitch ends: the status page shows the
                # reason, but no event is published.
                if self._memory.held() or self._memory.kept():
                    self._events.add("trouble", refusal.message, code=refusal.code, action=refusal.action)
                self._machine.advance(StationStep.RING_FULL)
            return
        self._machine.reasons.drop("ring-full")
        if self._machine.state is StationState.BLOCKED:
            self._machine.advance(StationStep.MEMORY_FREED)

    def warnings(self) -> tuple[Reason, ...]:
        """Return warnings about the next board: memory that callers hold, a doubtful board id, a draft."""
        order, doubt = self.orders.next or self.orders.order, None
        if order is not None and (why := self.orders.present_doubt) is not None:
            doubt = Reason(
                code="board-id-uncertain",
                message=f"The next run gets no board id: {order.board_id!r} was armed, but {why}.",
                action="Arm again with the id of the next board.",
            )
        short = self._memory.warning() if self._machine.state in _TAKING_BOARDS else None
        draft = order.draft if order is not None else None
        return tuple(warning for warning in (self._not_armed_again, short, draft, doubt) if warning is not None)

    def evicted(self, run: str, room_for: str = "the next board") -> None:
        """Record that the frames of a finished run were given up for the next board, or for something else."""
        try:
            self._archive.mark(run, RunStep.MEMORY_TAKEN)
        except VaoiError as error:
            # The database may have been replaced or set aside since the run: that must not cost the next board its bay.
            _log.warning("The eviction of run %s was not recorded: %s", run, error.message)
        self._events.add("run", f"Frames evicted to make room for {room_for}.", state=RunState.GONE, run=run)

    def tick(self) -> None:
        """Arm the line again for an order that was not cancelled, when memory and cameras allow it."""
        for board in self.orders.queue.expire(time.monotonic()):
            message = f"Board {board.name!r} left the machine upstream and did not reach the barrier; its order waits."
            action = "If it was taken off, let it in again from before that machine, or withdraw its order."
            self._events.add("trouble", message, code="board-gone", action=action, subject={"board": board.name})
            self.follow()
        order = self.orders.next
        if self._machine.state is not StationState.IDLE or not (self.orders.by_orders or self.orders.wants_more):
            return
        try:
            self._require_cameras(order)
        except DeviceError as refusal:
            self._note_not_armed(refusal.message, refusal.action)
            return
        if self._rearm_pace.remaining_s() == 0:
            self._rearm()

    def _note_not_armed(self, why: str, action: str) -> None:
        message = f"The line was armed before and could not be armed again: {why}"
        action = f"{action} The station tries again by itself.".strip()
        self._not_armed_again = Reason(code="not-armed-again", message=message, action=action)

    def _require_cameras(self, order: Order | None) -> None:
        if order is None or not order.despite_lost_cameras:
            readiness.require(self.health, self._config.cameras)

    def _keep_order(self) -> None:
        self._not_armed_again = None
        if self._standing is not None:
            self._standing.keep(self.orders.order, self.orders.runs_left, by_orders=self.orders.by_orders)

    def _keep_waiting(self) -> None:
        if self._standing is not None:
            self._standing.keep_waiting(self.orders.queue.kept)

    def _grant(self) -> None:
        if self._granted:
            return
        granted = self._memory.grant(run := self._run_ids.next())
        self._granted[run] = granted.bay.number
        self._acquisition.send(messages.Grant(run, granted.bay.number))
        if granted.evicted is not None:
            self.evicted(granted.evicted)

    def _rearm(self) -> None:
        reasons = self._machine.reasons
        try:
            if self.orders.next is not None:
                self._grant()
        except BusyError as refusal:
            # Its message names the present use of the memory; only the first one is published.
            first = all(reason.code != refusal.code for reason in reasons.all())
            reasons.hold(Reason(code=refusal.code, message=refusal.message, action=_ARMED_WHEN_FREE))
            if first:
                self._events.add("trouble", refusal.message, code=refusal.code, action=_ARMED_WHEN_FREE)
            return
        reasons.drop("ring-full")
        self._machine.advance(StationStep.ARM)
        self._send_arm()

    def _send_arm(self) -> None:
        self._set_for = self.orders.next
        self.plan = self._plan_of(self._set_for)
        self._acquisition.send(messages.Arm(self.plan))

    def _plan_of(self, order: Order | None) -> TriggerPlan:
        return order.plan if order is not None and order.plan is not None else TriggerPlan.of(self._config.line)

    def _set_again(self) -> None:
        """Note that the line watches the barrier again, and whether a board may have passed unnoticed meanwhile."""
        since_s, self._setting_since_s, now_s = self._setting_since_s, None, time.monotonic()
        order = self._set_for
        if since_s is None or order is None:
            return
        low, high = order.board_type.extent()
        speed_mm_s = (order.line or self._config.line).speed_mm_s
        if now_s - since_s > float(min(high - low)) * order.board_type.mm_per_unit / speed_mm_s:
            self.orders.doubt_since_last(now_s, "boards may have passed while the line was set for another order")

    def _send_disarm(self) -> None:
        if not self._disarm_sent:
            self._disarm_sent = True
            self._acquisition.send(messages.Disarm())

    def _close_requests(self, refusal: VaoiError) -> None:
        """Finish the requests of callers now that the line is disarmed, and serve those that waited for it."""
        self._disarm_sent = False
        arming, disarming = self._arming, self._disarming
        self._arming, self._disarming = [], []
        for completion in arming:
            completion.set_exception(refusal)
        for completion in disarming:
            completion.set_result(None)
        waiting = [*self._after_board, *self._after_disarm]
        self._after_board, self._after_disarm = [], []
        self._serve(waiting)

    def _serve(self, waiting: list[_Request]) -> None:
        """Arm for the newest of the requests that waited, on whose completion that of the others depends."""
        if waiting:
            *replaced, newest = waiting
            for request in replaced:
                newest.completion.add_done_callback(partial(_follow, request.completion))
            self.arm(*newest)


def _armed_for(order: Order | None, again: str = "") -> str:
    whom = "the orders that wait" if order is None else f"board type {order.board_type.name!r}"
    return f"Armed {again}for {whom}"


def _follow(other: Completion, done: Completion) -> None:
    if (refusal := done.exception()) is None:
        other.set_result(None)
    else:
        other.set_exception(refusal)
