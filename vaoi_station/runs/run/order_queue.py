"""The queue of orders, and which board takes which. It knows neither devices nor clocks: callers state host times.

| what is known of the line | the order of a board that interrupts the barrier |
|---|---|
| nothing | the first order that waited at that moment |
| messages of the neighbour upstream | that of the one board that can be at the barrier then, by its transport |

An order belongs to an announced board if it names the board; else the first order without a board id is taken, if it
is for the board's product; else the order that its product makes; else what the line was armed with. If no board can
be at the barrier, or several can, the run has no board id: an order is never guessed.
"""

from __future__ import annotations

from collections import OrderedDict, deque
from dataclasses import dataclass, replace
from typing import Literal, NamedTuple

from vaoi_station.errors import InputError, NotFoundError, StateError
from vaoi_station.model import Reason
from vaoi_station.runs.run.order import Order

MOST_WAITING = 200
"""Largest number of waiting orders."""
LATE_S = 5.0
"""Longest time from an edge of the barrier to the report of its run: later, no report can come of a board."""
_MOST_ARRANGEMENTS, _MOST_RUNS = 32, 256
_NEVER_S = float("-inf")


@dataclass(frozen=True)
class LineBoard:
    """A board as the neighbour upstream announces it; what is not needed here travels on in `details`."""

    board_id: str
    """Id of the board in the messages of the line."""
    barcodes: tuple[str, ...] = ()
    """What is written on the board, as far as the line knows it; the code that the cameras may see comes first."""
    product: str = ""
    board_type: str | None = None
    """Board type of the product; None: the product is unknown."""
    unusable: bool = False
    """Whether the product is known, but not its board type: then only an order that names the board is for it."""
    failed: Literal["unknown", "good", "bad"] = "unknown"
    side: Literal["top", "bottom"] | None = None
    """The side that is up; None: not stated."""
    details: object = None

    @property
    def name(self) -> str:
        """The board id of its run, unless its order states one: its code, which the cameras can compare."""
        return self.barcodes[0] if self.barcodes else self.board_id


@dataclass(frozen=True)
class Queued:
    """An order that waits for its board."""

    id: str
    order: Order
    priority: int = 0
    created: str = ""
    since_s: float = _NEVER_S
    """Time since which the caller's view of the line holds: a board that was missed later may have been this one."""


class Taken(NamedTuple):
    """The order of a board at the barrier; None if that is uncertain, because of `why`."""

    order: Order | None
    since_s: float = _NEVER_S
    """Time since which it is known that the order is for this board, unless another one passed unnoticed since."""
    why: str = ""
    doubts_s: float = _NEVER_S
    """Orders that have been known no later than this time are uncertain too."""
    counts: bool = False
    """Whether it is that with which the line was armed, which may be for a number of boards."""


class Shown(NamedTuple):
    """One order as callers see it."""

    queued: Queued
    coming: bool
    """Whether its board is on its way to the barrier."""


class _Announced(NamedTuple):
    board: LineBoard
    made: Order | None
    """The order that the board's product makes; None if the product is unknown."""

    def without_order(self, armed: Order | None) -> Order | None:
        """Return what a board is filmed for if no order waits for it."""
        return self.made or (None if self.board.unusable else armed)


@dataclass
class _Coming:
    """A board between the neighbour upstream and the barrier."""

    lane: int
    announced: _Announced
    queued: Queued | None
    started_s: float
    doubted: str = ""

    @property
    def board(self) -> LineBoard:
        return self.announced.board

    def order(self, armed: Order | None) -> Order | None:
        return self.queued.order if self.queued is not None else self.announced.without_order(armed)


class OrderQueue:
    """Waiting orders, announced boards, and boards on their way to the barrier. Times are host times."""

    def __init__(self, window_s: tuple[float, float] = (0.0, 30.0)) -> None:
        """Begin empty. `window_s`: shortest and longest time from the start of a board's transport to the barrier."""
        self.window_s = window_s
        self.by_messages = False
        """Whether boards take orders by messages of the line only."""
        self._silent_until_s = _NEVER_S
        """Time until which a board may come to the barrier that is not expected any more, or was never announced."""
        self._silent_why = ""
        self._arrangements: deque[tuple[float, tuple[Queued, ...]]] = deque([(_NEVER_S, ())], _MOST_ARRANGEMENTS)
        """The waiting orders since a time each: the edge of a board decides, but is reported later."""
        self._announced: dict[int, _Announced] = {}
        self._coming: list[_Coming] = []
        self._displaced: list[_Coming] = []
        """Doubted boards for which one at the barrier was taken: if it was another, they are still on their way."""
        self._last: _Coming | None = None
        """The board that was taken last."""
        self._boards: OrderedDict[str, LineBoard] = OrderedDict()

    # --- requests of callers

    @property
    def waiting(self) -> tuple[Queued, ...]:
        """The orders that wait, the next one first."""
        return self._arrangements[-1][1]

    @property
    def changed_s(self) -> float:
        """Time of the latest change of the waiting orders."""
        return self._arrangements[-1][0]

    @property
    def kept(self) -> tuple[Queued, ...]:
        """All orders that have not been taken, those of boards on their way first."""
        return (*(c.queued for c in self._coming if c.queued is not None), *self.waiting)

    def shown(self) -> tuple[Shown, ...]:
        """Return all orders that have not been taken, in the order in which their boards are expected."""
        coming = len(self.kept) - len(self.waiting)
        return tuple(Shown(queued, n < coming) for n, queued in enumerate(self.kept))

    def add(self, queued: Queued, now_s: float) -> None:
        """Add an order behind all of the same or a higher priority."""
        if len(self.waiting) >= MOST_WAITING:
            message = f"{MOST_WAITING} orders wait, which is the most."
            raise StateError(message, action="Withdraw orders, or wait for boards.", code="too-many-orders")
        name = queued.order.board_id
        if name is not None and (other := next((q for q in self.kept if q.order.board_id == name), None)):
            message = f"Order {other.id} is for board {name!r} already."
            raise StateError(message, action="Withdraw it first, or give this board its own id.", code="order-exists")
        self._place(replace(queued, since_s=now_s), self.waiting, None, now_s)

    def withdraw(self, order: str, now_s: float) -> None:
        """Remove an order. A board that is at the barrier or on its way to it keeps it."""
        self._arrange(_without(self.waiting, self._find(order).id), now_s)

    def move(self, order: str, position: int | None, priority: int | None, now_s: float) -> None:
        """Give an order another priority, or another position, from 1."""
        found, others = self._find(order), _without(self.waiting, order)
        if position is not None and position > len(others) + 1:
            raise InputError.field("order", "position", position, f"at most {len(others) + 1}, the number of orders")
        self._place(found if priority is None else replace(found, priority=priority), others, position, now_s)

    def resume(self, waiting: tuple[Queued, ...], now_s: float) -> None:
        """Let the orders wait that waited when the station ended."""
        self._arrange(tuple(replace(queued, since_s=now_s) for queued in waiting), now_s)

    def renew(self, now_s: float, known_s: float) -> None:
        """Take a caller's word that the next board belongs to the first order; it knew of boards until `known_s`."""
        self._arrange(tuple(replace(queued, since_s=known_s) for queued in self.waiting), now_s)

    def shared(self, order: Order) -> Order:
        """Return an order with the data of a waiting one that films the same: board types may be large."""
        alike = next((queued.order for queued in self.kept if _origin(queued.order) == _origin(order)), order)
        # Nothing of the board for which that one waits is for another board.
        return replace(alike.for_board(None, None), despite_lost_cameras=False)

    def stale(self, calibration: str) -> list[Order]:
        """Return the orders that were made with another calibration than the one with this digest."""
        coming = (c.order(None) for c in self._coming)
        every = [*(q.order for q in self.waiting), *(a.made for a in self._announced.values()), *coming]
        return [order for order in every if order is not None and order.calibration_digest != calibration]

    def remake(self, made: dict[str, Order], now_s: float) -> None:
        """Use other orders, by the names of their board types, because the calibration has changed."""

        def again(order: Order) -> Order:
            new = made.get(order.board_type.name, order)
            new = new.for_board(order.board_id, order.job_id, order.skip, order.flip)
            return replace(new, despite_lost_cameras=order.despite_lost_cameras)

        self._arrange(tuple(replace(queued, order=again(queued.order)) for queued in self.waiting), now_s)
        for lane, (board, order) in self._announced.items():
            self._announced[lane] = _Announced(board, order and again(order))
        for coming in self._coming:
            coming.announced = _Announced(coming.board, coming.announced.made and again(coming.announced.made))
            if coming.queued is not None:
                coming.queued = replace(coming.queued, order=again(coming.queued.order))

    # --- messages of the line

    def listen(self, on: bool, now_s: float) -> None:
        """Let boards take orders by messages only from now on, or because they are the first."""
        if on and not self.by_messages:
            self._silent_until_s = now_s + self.window_s[1]
            self._silent_why = "a board may have been on its way to the barrier before the messages of the line began"
        self.by_messages = on

    def announce(self, lane: int, board: LineBoard, made: Order | None, now_s: float) -> None:
        """Take the announcement of the next board of a lane; `made` is the order that its product makes."""
        self.listen(True, now_s)
        self._announced[lane] = _Announced(board, made)

    def withdrawn(self, lane: int) -> None:
        """Forget the board that was announced on a lane."""
        self._announced.pop(lane, None)

    def started(self, lane: int, now_s: float) -> None:
        """Take that the announced board of a lane is on its way to the barrier from now on."""
        if (announced := self._announced.pop(lane, None)) is None:
            raise StateError(f"No board was announced on lane {lane}.", code="no-board-announced")
        queued = self._order_of(announced)
        if queued is not None:
            self._arrange(_without(self.waiting, queued.id), now_s)
        coming = _Coming(lane, announced, queued, now_s)
        if now_s <= self._silent_until_s:
            coming.doubted = self._silent_why
        elif (before := next((c for c in self._displaced if self._meets(c, now_s)), None)) is not None:
            coming.doubted = f"board {before.board.name!r} may still come, as another may have been taken for it"
        self._coming.append(coming)

    def finished(self, lane: int, state: Literal["complete", "incomplete", "not-started"], now_s: float) -> None:
        """Take how the latest transport on a lane ended; no effect if its board has reached the barrier."""
        found = next((c for c in reversed(self._coming) if c.lane == lane), None)
        if found is None:
            return
        if state == "incomplete":
            found.doubted = f"the transport of board {found.board.name!r} to the station was not completed"
        elif state == "not-started":
            self._return(found, now_s)
            self._announced.setdefault(lane, found.announced)

    def refusals(self, lane: int, armed: Order | None) -> tuple[Reason, ...]:
        """Return why the next board of a lane must not be sent; `armed` is what the line was armed with."""
        if on_its_way := [*self._coming, *self._displaced]:
            message = f"Board {on_its_way[0].board.name!r} is on its way to the barrier."
            return (Reason(code="board-in-gap", message=message, action="Wait until it has reached the barrier."),)
        announced, first = self._announced.get(lane), next(iter(self._announced), lane)
        if announced is None:
            return ()
        if first != lane:
            message = f"The board of lane {first} comes first."
            return (Reason(code="board-in-gap", message=message, action="Wait until it has reached the barrier."),)
        if (order := self._of_announced(announced, armed)) is None:
            board = announced.board
            message = f"No order is for board {board.name!r} of product {board.product!r}."
            action = "Post its order, give its product a board type, or arm for a board type."
            return (Reason(code="board-without-order", message=message, action=action),)
        if announced.board.side not in (None, order.board_type.side):
            message = f"Board {announced.board.name!r} comes with its {announced.board.side} up."
            action = f"Turn it over, or give an order for a board type of its {announced.board.side}."
            return (Reason(code="board-flipped", message=message, action=action),)
        return ()

    # --- boards

    def next(self, armed: Order | None) -> Order | None:
        """Return the order of the next board as far as it is known now; `armed`: what the line was armed with."""
        found = None
        if self._coming:
            found = self._coming[0].order(armed)
        elif self._announced:
            found = self._of_announced(next(iter(self._announced.values())), armed)
        return found or (self.waiting[0].order if self.waiting else armed)

    @property
    def first(self) -> Queued | None:
        """The order that the next board takes because it is the first; None if messages decide, or none waits."""
        return None if self.by_messages else next(iter(self.waiting), None)

    def take(self, run: str, barrier_s: float, armed: Order | None) -> Taken | None:
        """Return the order of the board that interrupted the barrier at a time; None if it takes none of the queue."""
        if self.by_messages:
            return self._take_announced(run, barrier_s, armed)
        if barrier_s <= self._arrangements[0][0]:
            why = "more changes of the queue were made while it waited than are kept"
            return Taken(None, why=why, doubts_s=self.changed_s)
        # Boards come in the order of their edges: no later one needs the arrangements before this one.
        while len(self._arrangements) > 1 and self._arrangements[1][0] < barrier_s:
            self._arrangements.popleft()
        if (found := next(iter(self._arrangements[0][1]), None)) is None:
            return None
        for n, (since_s, waiting) in enumerate(self._arrangements):
            self._arrangements[n] = since_s, _without(waiting, found.id)
        return Taken(found.order, found.since_s)

    def missed(self, edge_s: float, now_s: float) -> None:
        """Take that the board with this edge of the barrier passed without a run: its order waits again."""
        for coming in self._at(edge_s):
            self._return(coming, now_s)

    def expire(self, now_s: float) -> list[LineBoard]:
        """Return the boards that should have reached the barrier, and did not; their orders wait again."""
        self._displaced = [c for c in self._displaced if self._meets(c, now_s)]
        gone = [c for c in self._coming if c.started_s + self.window_s[1] + LATE_S < now_s]
        for coming in gone:
            self._return(coming, now_s)
            # It may come nevertheless, and would take the order of the board behind it.
            self._silent_until_s = now_s + self.window_s[1]
            self._silent_why = f"board {coming.board.name!r} did not reach the barrier in time, and may come later"
        return [coming.board for coming in gone]

    def board_of_run(self, run: str) -> LineBoard | None:
        """Return the announced board that a run shows; None if that is not certain, or it was long ago."""
        return self._boards.get(run)

    def disown(self, run: str) -> None:
        """Take back that a run shows an announced board."""
        self._boards.pop(run, None)

    def _take_announced(self, run: str, barrier_s: float, armed: Order | None) -> Taken:
        matching = self._at(barrier_s)
        if not matching:
            # If it came when the one before might have come, that one may have taken the order of this one.
            last = self._last if self._last is not None and self._fits(self._last, barrier_s) else None
            why = "no message of the line had announced it"
            return Taken(None, why=why, doubts_s=_NEVER_S if last is None else last.started_s)
        taken = matching[0]
        self._coming.remove(taken)
        self._last = taken
        if taken.doubted:
            self._displaced.append(taken)
        if len(matching) > 1:
            names = " and ".join(repr(c.board.name) for c in matching)
            for other in matching[1:]:
                other.doubted = f"it or another of the boards {names} was at the barrier before"
            return Taken(None, why=f"the boards {names} were on their way to the barrier")
        board, order = taken.board, taken.order(armed)
        if order is None or (why := _doubt(taken, order)):
            return Taken(None, why=why if order is not None else f"no order was for board {board.name!r}")
        self._boards[run] = board
        while len(self._boards) > _MOST_RUNS:
            self._boards.popitem(last=False)
        # A board that passed unnoticed since the start of the transport may have been this one.
        of_line = taken.queued is None and taken.announced.made is None
        return Taken(replace(order, board_id=order.board_id or board.name), taken.started_s, counts=of_line)

    def _at(self, barrier_s: float) -> list[_Coming]:
        """Return the boards that may be at the barrier at a time, the one that started first at the front."""
        return [coming for coming in self._coming if self._fits(coming, barrier_s)]

    def _fits(self, coming: _Coming, barrier_s: float) -> bool:
        shortest_s, longest_s = self.window_s
        return coming.started_s + shortest_s <= barrier_s <= coming.started_s + longest_s

    def _meets(self, coming: _Coming, started_s: float) -> bool:
        """Return whether a board can be at the barrier as late as one whose transport begins at a time."""
        shortest_s, longest_s = self.window_s
        return started_s + shortest_s <= coming.started_s + longest_s

    def _order_of(self, announced: _Announced) -> Queued | None:
        """Return the waiting order of an announced board: it names the board, or none, and fits its product."""
        board, made, ids = announced.board, announced.made, _ids(announced.board)
        if (named := next((q for q in self.waiting if q.order.board_id in ids), None)) is not None:
            return named
        free = (q for q in self.waiting if q.order.board_id is None and board.side in (None, q.order.board_type.side))
        if made is None:
            # It is not known of which product a waiting order is, unless the machine upstream states none.
            return None if board.product else next(free, None)
        return next((q for q in free if q.order.board_type.name == made.board_type.name), None)

    def _of_announced(self, announced: _Announced, armed: Order | None) -> Order | None:
        queued = self._order_of(announced)
        return queued.order if queued is not None else announced.without_order(armed)

    def _return(self, coming: _Coming, now_s: float) -> None:
        self._coming.remove(coming)
        if coming.queued is not None:
            self._arrange((coming.queued, *self.waiting), now_s)

    def _find(self, order: str) -> Queued:
        found = next((queued for queued in self.kept if queued.id == order), None)
        if found is None:
            action = "GET orders lists the orders that wait."
            raise NotFoundError(f"No order {order} waits.", action=action, code="unknown-order")
        if found not in self.waiting:
            message = f"The board of order {order} is on its way to the barrier."
            raise StateError(message, action="Wait until it has passed.", code="order-taken")
        return found

    def _place(self, queued: Queued, others: tuple[Queued, ...], position: int | None, now_s: float) -> None:
        """Let an order wait at a position; without one, behind all of the same or a higher priority."""
        behind = (n + 1 for n in reversed(range(len(others))) if others[n].priority >= queued.priority)
        place = next(behind, 0) if position is None else position - 1
        # If a waiting order may be for a board that has passed, boards and orders are out of step, wherever this one is
        # put: only who arms again says that they are not.
        since_s = min((queued.since_s, *(other.since_s for other in others)))
        self._arrange((*others[:place], replace(queued, since_s=since_s), *others[place:]), now_s)

    def _arrange(self, waiting: tuple[Queued, ...], now_s: float) -> None:
        self._arrangements.append((now_s, waiting))


def _doubt(coming: _Coming, order: Order) -> str:
    """Return why it is uncertain that a board has an order; empty if it is not."""
    board = coming.board
    if not coming.doubted and order.board_id is not None and order.board_id not in _ids(board):
        return f"the line was armed with {order.board_id!r}, but board {board.name!r} was announced"
    if not coming.doubted and board.side not in (None, order.board_type.side):
        return f"board {board.name!r} was announced with its {board.side} up, but its order films the other side"
    return coming.doubted


def _origin(order: Order) -> tuple[object, ...]:
    reference = None if order.reference is None else order.reference.run
    return order.board_type_digest, order.calibration_digest, order.configuration_digest, reference, order.setup.method


def _ids(board: LineBoard) -> frozenset[str]:
    return frozenset((board.board_id, *board.barcodes))


def _without(waiting: tuple[Queued, ...], order: str) -> tuple[Queued, ...]:
    return tuple(queued for queued in waiting if queued.id != order)
