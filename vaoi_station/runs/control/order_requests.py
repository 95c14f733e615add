"""Requests about orders that wait, and messages of the neighbours in the line about their boards."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import replace
from typing import Literal, NamedTuple

from vaoi_station.errors import InputError
from vaoi_station.model import BoardType, Reason
from vaoi_station.runs.control.core import Core
from vaoi_station.runs.run.inbox import Inbox
from vaoi_station.runs.run.order import Order
from vaoi_station.runs.run.order_queue import LineBoard, OrderQueue, Queued
from vaoi_station.runs.states.run_ids import RunIds, utc
from vaoi_station.runs.states.schemas import FlipAxis, OrderList, OrderStatus

MakeOrder = Callable[[BoardType, "str | None", "str | None"], Order]
"""Function that checks a board type, and makes an order from it, the board id and the job id."""


_NONE = OrderStatus(id="", board_type="", created="")


class WantedOrder(NamedTuple):
    """An order as a caller states it."""

    board_type: str
    board_id: str | None = None
    job_id: str | None = None
    skip: tuple[str, ...] = ()
    side: Literal["top", "bottom"] | None = None
    flip: FlipAxis | None = None
    priority: int = 0
    allow_lost_cameras: bool = False


class OrderRequests:
    """Lets callers change the orders that wait, and neighbours announce boards. Any thread may call its methods."""

    def __init__(
        self,
        inbox: Inbox,
        core: Core,
        make_order: MakeOrder,
        board_type: Callable[[str], BoardType],
        held: Callable[[], tuple[Reason, ...]],
    ) -> None:
        """Connect the parts. `held` returns, in the coordinator's thread, why the next board must wait."""
        self._inbox, self._core, self._make_order, self._board_type, self._held = (
            inbox, core, make_order, board_type, held
        )  # fmt: skip
        self._ids = RunIds()

    # --- callers

    def list(self) -> OrderList:
        """Return the orders that no board has taken yet, the next one first."""
        return self._inbox.ask(self._listed)

    def add(self, wanted: WantedOrder) -> OrderStatus:
        """Let an order wait for its board, behind all of the same or a higher priority.

        Raises:
            NotFoundError: the board type is unknown.
            InputError: its side is the other one, or a position to skip does not exist.
            StateError: an order for this board waits already, or too many wait; the board type cannot be filmed.
        """
        order = self._made(wanted.board_type)
        if wanted.side not in (None, order.board_type.side):
            allowed = f"{order.board_type.side}, the side that board type {wanted.board_type!r} describes"
            raise InputError.field("order", "side", wanted.side, allowed)
        order = order.for_board(wanted.board_id, wanted.job_id, wanted.skip, wanted.flip)
        order = replace(order, despite_lost_cameras=wanted.allow_lost_cameras)
        queued = Queued(self._ids.next(), order, wanted.priority, utc())
        return self._change(lambda queue, now_s: queue.add(queued, now_s), queued.id)

    def withdraw(self, order: str) -> None:
        """Remove an order. `NotFoundError`: it does not wait; `StateError`: its board is on its way to the barrier."""
        self._change(lambda queue, now_s: queue.withdraw(order, now_s))

    def move(self, order: str, position: int | None, priority: int | None) -> OrderStatus:
        """Give an order another position, from 1, or another priority; raises the errors of `withdraw`."""
        return self._change(lambda queue, now_s: queue.move(order, position, priority, now_s), order)

    def renew(self) -> None:
        """Make the orders again that were made with another calibration than that in force."""
        stale = self._inbox.ask(lambda: self._core.line.orders.queue.stale(self._core.watch.digest))
        if not stale:
            return
        made = {name: self._made(name) for name in dict.fromkeys(order.board_type.name for order in stale)}
        self._change(lambda queue, now_s: queue.remake(made, now_s))

    # --- messages of the line

    def by_messages(self, on: bool) -> None:
        """State whether a neighbour announces every board: then no board takes an order because it is the first."""
        self._change(lambda queue, now_s: queue.listen(on, now_s))

    def announce(self, lane: int, board: LineBoard) -> tuple[Reason, ...]:
        """Take the announcement of the next board of a lane; raises the errors of `add` about its board type.

        Like each of the next methods it returns what `may_accept` returns then.
        """
        made = None if board.board_type is None else self._make_order(self._board_type(board.board_type), None, None)
        return self._told(lane, lambda queue, now_s: queue.announce(lane, board, made and queue.shared(made), now_s))

    def withdrawn(self, lane: int) -> tuple[Reason, ...]:
        """Forget the board that was announced on a lane."""
        return self._told(lane, lambda queue, _: queue.withdrawn(lane))

    def started(self, lane: int) -> tuple[Reason, ...]:
        """Take that the announced board of a lane is on its way to the barrier from now on."""
        return self._told(lane, lambda queue, now_s: queue.started(lane, now_s))

    def finished(self, lane: int, state: Literal["complete", "incomplete", "not-started"]) -> tuple[Reason, ...]:
        """Take how the latest transport on a lane ended."""
        return self._told(lane, lambda queue, now_s: queue.finished(lane, state, now_s))

    def may_accept(self, lane: int) -> tuple[Reason, ...]:
        """Return why the next board of a lane must not be sent now; empty if it may be."""
        return self._inbox.ask(self._refusals, lane)

    def board_of_run(self, run: str) -> LineBoard | None:
        """Return the announced board that a run shows; None if that is not certain, or it was long ago."""
        return self._inbox.ask(lambda: self._core.line.orders.queue.board_of_run(run))

    def came_failed(self, run: str) -> bool:
        """Return whether contacts or messages announced the board of a run as failed; "": may one without a run be."""
        return self._core.contacts.came_failed(run)

    def _refusals(self, lane: int) -> tuple[Reason, ...]:
        orders = self._core.line.orders
        return (*orders.queue.refusals(lane, orders.order), *self._held())

    def _told(self, lane: int, change: Callable[[OrderQueue, float], object]) -> tuple[Reason, ...]:
        """Change the queue by a message of a lane, and return in the same turn why its next board must wait."""

        def do() -> tuple[Reason, ...]:
            change(self._core.line.orders.queue, time.monotonic())
            self._core.line.follow()
            return self._refusals(lane)

        return self._inbox.ask(do)

    def _change(self, change: Callable[[OrderQueue, float], object], order: str = "") -> OrderStatus:
        """Change the queue in the coordinator's thread, let the line follow it, and return what an order is then."""

        def do() -> tuple[OrderStatus, ...]:
            change(self._core.line.orders.queue, time.monotonic())
            listed = self._core.line.orders.listed()
            self._core.line.follow()
            return listed

        return next((status for status in self._inbox.ask(do) if status.id == order), _NONE)

    def _made(self, board_type: str) -> Order:
        """Make an order; of alike ones that wait all share the data of their board type, which may be large."""
        order = self._make_order(self._board_type(board_type), None, None)
        return self._inbox.ask(lambda: self._core.line.orders.queue.shared(order))

    def _listed(self) -> OrderList:
        orders = self._core.line.orders
        return OrderList(orders=orders.listed(), by_messages=orders.queue.by_messages)
