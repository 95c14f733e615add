"""The order in force for the next boards, those before it, and those that wait: which board gets which."""

from __future__ import annotations

from collections import deque
from dataclasses import dataclass, field
from typing import NamedTuple

from vaoi_station.runs.run.order import Order
from vaoi_station.runs.run.order_queue import OrderQueue
from vaoi_station.runs.states.schemas import ArmedWith, OrderStatus

_NEVER_S = float("-inf")
_MOST_FORMER = 16
"""Number of former orders that are kept for boards that have interrupted the barrier, but have no pulse yet."""


class _Doubt(NamedTuple):
    """A board that may have passed without a run."""

    edge_s: float
    """Host time at which the board interrupted the barrier; if it is not known, the earliest possible one."""
    published_s: float
    """Host time at which callers could first know of the board."""
    why: str


class _FormerOrder(NamedTuple):
    """An order that was in force before the present one; None: no order was in force."""

    order: Order | None
    since_s: float
    known_s: float
    by_orders: bool


@dataclass
class Orders:
    """The order in force, and those before it, which still apply to boards at the barrier before the change.

    Times are host times by time.monotonic().
    """

    order: Order | None = None
    """What the line was armed with, for boards for which no order waits; None: it was not, or for waiting orders."""
    runs_left: int | None = None
    """Number of boards still to be filmed; None: no limit."""
    by_orders: bool = False
    """Whether the line was armed for waiting orders alone."""
    since_s: float = _NEVER_S
    known_s: float = _NEVER_S
    """Time until which the caller knew of all boards that had been reported."""
    queue: OrderQueue = field(default_factory=OrderQueue)
    uncertain: str = ""
    """Why it is not known which order the board has that was taken last; empty if it is."""
    taken_since_s: float = _NEVER_S
    """Time since which the order that was taken last has been in force."""
    resumed: bool = False
    """Whether the order was in force before a restart of the station, and no caller has armed since."""
    _former: deque[_FormerOrder] = field(default_factory=lambda: deque(maxlen=_MOST_FORMER))
    """From the oldest to the newest, those that a board may still need whose first pulse was not fired yet."""
    _edge_s: float = _NEVER_S
    """Time at which the latest board that has a run interrupted the barrier."""
    _doubts: deque[_Doubt] = field(default_factory=lambda: deque(maxlen=64))

    @property
    def armed(self) -> bool:
        """Whether the line was armed, and neither disarmed since nor for a number of boards that have passed."""
        return self.order is not None or self.by_orders

    @property
    def next(self) -> Order | None:
        """The order of the next board as far as it is known; None if no board is to be filmed."""
        return self.queue.next(self._for_any) if self.armed else None

    @property
    def _present(self) -> _FormerOrder:
        return _FormerOrder(self.order, self.since_s, self.known_s, self.by_orders)

    @property
    def _for_any(self) -> Order | None:
        return self.order if self.runs_left != 0 else None

    def accept(self, order: Order | None, runs: int | None, now_s: float, known_s: float | None = None) -> None:
        """Put an order in force for the boards that interrupt the barrier after `now_s`; `runs` limits their number.

        Waiting orders come before it. None: boards are filmed for waiting orders alone. The caller knew of the boards
        that had been reported until `known_s`, by default until now.
        """
        self._former.append(self._present)
        self.order, self.runs_left, self.since_s, self.resumed = order, runs, now_s, False
        self.known_s = now_s if known_s is None else known_s
        self.by_orders = order is None
        self.queue.renew(now_s, self.known_s)

    def take(self, barrier_s: float, run: str = "", granted: Order | None = None) -> Order | None:
        """Return the order of a board that interrupted the barrier at `barrier_s`, and count the board.

        `granted` is the order for which cameras and controller were set: if the board's order is uncertain, it is
        filmed for this one, without an id.
        """
        self._edge_s, self.uncertain = max(self._edge_s, barrier_s), ""
        if (taken := self.queue.take(run, barrier_s, self._for_any)) is not None:
            if taken.order is None:
                if granted is not None and self.runs_left is not None:  # it is filmed, so it counts
                    self.runs_left = max(self.runs_left - 1, 0)
                return self.disown(run, granted, taken.why, taken.doubts_s)
            self.taken_since_s = taken.since_s
            if taken.counts and self.runs_left is not None:
                self.runs_left = max(self.runs_left - 1, 0)
            return taken.order
        if self.queue.first is not None:
            why = "a board had reached the barrier just before an order was given, which may have been for it"
            self.doubt(_NEVER_S, self.queue.changed_s, why)
        # The time at the barrier decides: until the first pulse, orders may be accepted that are for later boards.
        every = [*self._former, self._present]
        latest = max((n for n, one in enumerate(every) if one.since_s <= barrier_s), default=0)
        if every[latest].by_orders:
            return self.disown(run, granted, "it had reached the barrier before an order was given")
        # A board that came while no order was in force belongs to the order before, else to the next one.
        found = next((n for n in (*range(latest, -1, -1), *range(latest, len(every))) if every[n].order), latest)
        if len(self._former) == _MOST_FORMER and barrier_s < every[0].since_s:
            self.doubt(_NEVER_S, every[found].since_s, "more orders were given while it waited than are kept")
        # Boards come in the order of their edges: no later one needs the orders before this one.
        for _ in range(found):
            self._former.popleft()
        self.taken_since_s = every[found].known_s
        # Only boards of the present order are counted, because `runs_left` belongs to it.
        if found == len(every) - 1 and self.runs_left is not None:
            self.runs_left = max(self.runs_left - 1, 0)
        return every[found].order

    def disown(self, run: str, granted: Order | None, why: str, doubts_s: float = _NEVER_S) -> Order | None:
        """Return what a run of uncertain order is filmed for; orders known since `doubts_s` are uncertain as well."""
        self.queue.disown(run)
        self.uncertain, self.taken_since_s = why, _NEVER_S
        if doubts_s > _NEVER_S:
            self.doubt(_NEVER_S, doubts_s, f"a board came whose order is uncertain: {why}")
        return None if granted is None else granted.for_board(None, None)

    def cancel(self, now_s: float) -> None:
        """End the order in force. A board that interrupted the barrier before `now_s` keeps it; orders still wait."""
        if self.armed:
            self._former.append(self._present)
            self.order, self.runs_left, self.by_orders, self.since_s, self.known_s = None, None, False, now_s, now_s

    def doubt_since_last(self, now_s: float, why: str) -> None:
        """Record that boards may have passed without a run since the latest board that has one, until now.

        Edges are reported late: a board whose edge is older than `now_s` may still begin its run after this.
        """
        self.doubt(min(self._edge_s, now_s), now_s, why)

    def doubt(self, edge_s: float, published_s: float, why: str) -> None:
        """Record that a board may have passed without a run, and when callers could first know of it."""
        self._doubts.append(_Doubt(edge_s, published_s, why))

    def doubt_of(self, since_s: float, barrier_s: float) -> str | None:
        """Return why the id of an order may belong to another board than the one at `barrier_s`; None if certain."""
        # An order counts boards from the time at which it was accepted, or until which its caller knew all missed
        # boards. A board that passed unnoticed may have been the one for which the order was given.
        why = (d.why for d in reversed(self._doubts) if d.edge_s < barrier_s and since_s <= d.published_s)
        return next(why, None)

    @property
    def present_doubt(self) -> str | None:
        """Why the armed board id may belong to another board than the next; None if certain, or none is armed."""
        first = self.queue.first
        order, since_s = (self.order, self.known_s) if first is None else (first.order, first.since_s)
        if not self.armed or order is None or order.board_id is None or self.queue.by_messages:
            return None
        return self.doubt_of(since_s, float("inf"))

    @property
    def references(self) -> set[str]:
        """Ids of the reference runs against which boards may still be placed."""
        waiting = (queued.order for queued in self.queue.kept)
        every = [self.order, *waiting, *(former.order for former in self._former)]
        return {order.reference.run for order in every if order and order.reference}

    @property
    def board_types(self) -> set[str]:
        """Names of the board types that the line was armed with, or for which orders wait."""
        every = [self.order, *(queued.order for queued in self.queue.kept)]
        return {order.board_type.name for order in every if order is not None}

    @property
    def wants_more(self) -> bool:
        """Whether another board is to be filmed."""
        return self.next is not None

    def listed(self, most: int | None = None) -> tuple[OrderStatus, ...]:
        """Return the orders that have not been taken by a board, the next one first; at most the given number."""
        known_s = float("inf")
        return tuple(
            OrderStatus(
                id=queued.id,
                board_type=queued.order.board_type.name,
                board_id=queued.order.board_id,
                job_id=queued.order.job_id,
                skip=queued.order.skip,
                side=queued.order.board_type.side,
                flip=queued.order.flip,
                priority=queued.priority,
                state="coming" if coming else "waiting",
                certain=coming or self.queue.by_messages or self.doubt_of(queued.since_s, known_s) is None,
                created=queued.created,
            )
            for queued, coming in self.queue.shown()[:most]
        )

    def shown(self) -> ArmedWith | None:
        """Return what `GET station` and the page show of the next board's order; None if no order is in force."""
        if not self.armed or (order := self.next or self.order) is None:
            return None
        shown = order.shown(self.runs_left if self.queue.first is None else None)
        return shown.model_copy(update={"board_id_certain": self.present_doubt is None, "resumed": self.resumed})
