"""Which board takes which order, over random boards, orders, removals by hand and restarts: never a wrong id."""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Any

import pytest
from hypothesis import settings
from hypothesis import strategies as st
from hypothesis.stateful import RuleBasedStateMachine, precondition, rule

from vaoi_station.errors import InputError, NotFoundError, StateError
from vaoi_station.model import BoardType, Fiducial
from vaoi_station.runs.run.order import Order
from vaoi_station.runs.run.order_queue import LATE_S, MOST_WAITING, LineBoard, OrderQueue, Queued
from vaoi_station.runs.run.orders import Orders
from vaoi_station.stitching.work import StitchSetup

SHORTEST_S, LONGEST_S = 2.0, 6.0


def an_order(board_id: str | None = None, board_type: str = "small") -> Order:
    marks = (Fiducial(name="F1", x=5, y=5, diameter=1), Fiducial(name="F2", x=35, y=25, diameter=1))
    made = BoardType(name=board_type, outline=((0, 0), (40, 30)), fiducials=marks, components=())
    return Order(made, board_id, None, StitchSetup((), (0.0, 100.0), 0.1, made), "", "", "")


ORDER = an_order()


@dataclass
class Run:
    """A run whose board has left the barrier; `board` is the board that its pictures show."""

    name: str
    board: str
    edge_s: float
    order: Order
    uncertain: str
    since_s: float


class Line(RuleBasedStateMachine):
    """What both kinds of lines have in common: edges are reported late, runs end later still."""

    def __init__(self) -> None:
        super().__init__()
        self.now_s, self.number = 100.0, 0
        self.orders = Orders(queue=OrderQueue((SHORTEST_S, LONGEST_S)))
        self.orders.accept(None, None, self.now_s)
        self.at_barrier: list[tuple[str, float]] = []
        self.runs: list[Run] = []

    @property
    def queue(self) -> OrderQueue:
        return self.orders.queue

    def new(self) -> str:
        self.number += 1
        return f"b{self.number}"

    def waiting(self) -> list[str | None]:
        return [queued.order.board_id for queued in self.queue.waiting]

    def pick(self, data: Any) -> Queued:
        found: Queued = data.draw(st.sampled_from(self.queue.waiting))
        return found

    @rule(seconds=st.floats(0.01, 3.0))
    def time_passes(self, seconds: float) -> None:
        self.now_s += seconds

    @precondition(lambda self: self.at_barrier)
    @rule()
    def the_first_pulse_of_a_board_is_reported(self) -> None:
        board, edge_s = self.at_barrier.pop(0)
        order = self.orders.take(edge_s, f"run of {board}", ORDER)
        assert order is not None
        self.runs.append(Run(f"run of {board}", board, edge_s, order, self.orders.uncertain, self.orders.taken_since_s))

    @precondition(lambda self: self.at_barrier)
    @rule()
    def a_board_is_missed(self) -> None:
        _, edge_s = self.at_barrier.pop(0)
        self.queue.missed(edge_s, self.now_s)
        self.orders.doubt(edge_s, self.now_s, "a board had passed without a run of its own before")
        self.now_s += 0.01  # what a caller says later was said with the knowledge of it

    @precondition(lambda self: self.runs)
    @rule()
    def a_run_ends_with_the_id_of_its_board_or_none(self) -> None:
        run = self.runs.pop(0)
        certain = not run.uncertain and self.orders.doubt_of(run.since_s, run.edge_s) is None
        if certain and run.order.board_id is not None:
            assert run.order.board_id == run.board
        if run.uncertain:
            assert run.order.board_id is None
            assert self.queue.board_of_run(run.name) is None

    def restart(self) -> None:
        kept = self.queue.kept
        self.orders = Orders(queue=OrderQueue((SHORTEST_S, LONGEST_S)))
        self.queue.resume(kept, self.now_s)
        self.orders.accept(None, None, self.now_s)
        self.orders.doubt(self.now_s, self.now_s, "the station was restarted")
        self.at_barrier, self.runs = [], []


class WithoutMessages(Line):
    """A line whose boards take the first order: they come as the caller's queue says, unless the station misses one."""

    def __init__(self) -> None:
        super().__init__()
        self.upstream: list[str] = []
        """Boards that have not reached the barrier, the next one first."""

    def follow_the_queue(self) -> None:
        """Let the boards come as the caller has arranged their orders."""
        places = {name: n for n, name in enumerate(self.waiting())}
        if all(name in places for name in self.upstream):
            self.upstream.sort(key=lambda name: places[name])

    @rule(priority=st.integers(0, 2))
    def an_order_is_posted(self, priority: int) -> None:
        name = self.new()
        self.queue.add(Queued(name, replace(ORDER, board_id=name), priority), self.now_s)
        self.upstream.append(name)
        self.follow_the_queue()

    @precondition(lambda self: self.queue.waiting)
    @rule(data=st.data())
    def a_board_is_taken_off_and_its_order_withdrawn(self, data: Any) -> None:
        order = self.pick(data)
        self.queue.withdraw(order.id, self.now_s)
        self.upstream = [name for name in self.upstream if name != order.id]

    @precondition(lambda self: self.queue.waiting)
    @rule(data=st.data())
    def boards_are_put_in_another_order(self, data: Any) -> None:
        position = data.draw(st.none() | st.integers(1, len(self.queue.waiting)))
        self.queue.move(self.pick(data).id, position, None if position is not None else 1, self.now_s)
        self.follow_the_queue()

    @precondition(lambda self: self.upstream)
    @rule()
    def a_board_reaches_the_barrier(self) -> None:
        self.now_s += 0.01  # two boards never come at one time
        self.at_barrier.append((self.upstream.pop(0), self.now_s))

    @rule(passed=st.integers(0, 2))
    def boards_pass_unwatched(self, passed: int) -> None:
        del self.upstream[:passed]
        self.orders.doubt_since_last(self.now_s, "the controller was reset")

    @rule(passed=st.integers(0, 2))
    def the_station_is_restarted(self, passed: int) -> None:
        self.restart()
        del self.upstream[:passed]

    @rule()
    def the_line_is_armed_again_after_boards_and_orders_were_compared(self) -> None:
        for queued in self.queue.waiting:
            if queued.id not in self.upstream:
                self.queue.withdraw(queued.id, self.now_s)
        self.upstream = [name for name in self.waiting() if name is not None]
        self.orders.accept(None, None, self.now_s)


class WithMessages(Line):
    """A line whose neighbour announces boards. Boards are put in by hand only while none can be at the barrier."""

    def __init__(self) -> None:
        super().__init__()
        self.queue.listen(True, self.now_s - 2 * LONGEST_S)
        self.gap: list[tuple[str, float]] = []
        self.next: str | None = None

    @rule(known=st.booleans(), named=st.booleans())
    def an_order_is_posted(self, known: bool, named: bool) -> None:
        name = self.next if known and self.next is not None else self.new()
        if name not in self.waiting():
            order = replace(ORDER, board_id=name if named else None)
            self.queue.add(Queued(f"o{self.new()}", order), self.now_s)

    @precondition(lambda self: self.next is None)
    @rule(known=st.booleans())
    def a_board_is_announced(self, known: bool) -> None:
        self.next = self.new()
        self.queue.announce(1, LineBoard(self.next), ORDER if known else None, self.now_s)

    @precondition(lambda self: self.next is not None)
    @rule()
    def the_announcement_is_withdrawn(self) -> None:
        self.queue.withdrawn(1)
        self.next = None

    @precondition(lambda self: self.next is not None)
    @rule(obedient=st.booleans())
    def a_transport_begins(self, obedient: bool) -> None:
        if self.next is None or (obedient and self.queue.refusals(1, None)):
            return
        self.queue.started(1, self.now_s)
        self.gap.append((self.next, self.now_s))
        self.next = None

    @precondition(lambda self: self.gap)
    @rule(state=st.sampled_from(["complete", "incomplete"]))
    def a_transport_ends(self, state: Any) -> None:
        self.queue.finished(1, state, self.now_s)

    @precondition(lambda self: self.gap)
    @rule(share=st.floats(0.0, 1.0), removed=st.booleans())
    def a_board_leaves_the_gap(self, share: float, removed: bool) -> None:
        name, started_s = self.gap.pop(0)
        earliest_s = max(started_s + SHORTEST_S, self.now_s)
        if removed or earliest_s > started_s + LONGEST_S - 0.01:
            return  # It was taken off by hand.
        self.now_s = 0.01 + earliest_s + share * (started_s + LONGEST_S - earliest_s - 0.01)
        self.at_barrier.append((name, self.now_s))

    @rule()
    def a_board_is_put_in_by_hand(self) -> None:
        self.now_s += 0.01
        if not self.queue._at(self.now_s):
            self.at_barrier.append((self.new(), self.now_s))

    @rule()
    def boards_that_never_came_are_given_up(self) -> None:
        self.queue.expire(self.now_s)

    @rule()
    def the_station_is_restarted(self) -> None:
        self.restart()
        self.queue.listen(True, self.now_s)
        self.next = None


WithoutMessages.TestCase.settings = settings(max_examples=150, stateful_step_count=40, deadline=None)
WithMessages.TestCase.settings = settings(max_examples=150, stateful_step_count=40, deadline=None)
TestWithoutMessages = WithoutMessages.TestCase
TestWithMessages = WithMessages.TestCase


@pytest.fixture
def orders() -> Orders:
    """Orders of a line that was armed for waiting ones at 10 s."""
    orders = Orders(queue=OrderQueue((SHORTEST_S, LONGEST_S)))
    orders.accept(None, None, 10.0)
    return orders


def post(orders: Orders, name: str, priority: int = 0, now_s: float = 11.0, board_type: str = "small") -> None:
    orders.queue.add(Queued(name, an_order(name, board_type), priority), now_s)


def ids(orders: Orders) -> list[str | None]:
    return [queued.order.board_id for queued in orders.queue.waiting]


def test_a_higher_priority_comes_first_and_a_position_counts_from_one(orders: Orders) -> None:
    for name, priority in (("a", 0), ("b", 0), ("c", 5), ("d", 5)):
        post(orders, name, priority)
    assert ids(orders) == ["c", "d", "a", "b"]
    orders.queue.move("b", 1, None, 12.0)
    orders.queue.move("a", None, 5, 12.0)
    assert ids(orders) == ["b", "c", "d", "a"]
    with pytest.raises(InputError, match="position is 5, but must be at most 4"):
        orders.queue.move("b", 5, None, 12.0)


def test_a_second_order_for_a_board_and_too_many_are_refused(orders: Orders) -> None:
    post(orders, "a")
    with pytest.raises(StateError, match="Order a is for board 'a' already"):
        post(orders, "a")
    with pytest.raises(NotFoundError, match="No order b waits"):
        orders.queue.withdraw("b", 12.0)
    for n in range(MOST_WAITING - 1):
        post(orders, f"n{n}")
    with pytest.raises(StateError, match="200 orders wait"):
        post(orders, "one more")


def test_only_arming_again_makes_orders_certain_after_a_missed_board(orders: Orders) -> None:
    post(orders, "a")
    post(orders, "b")
    orders.doubt(12.0, 12.0, "a board was missed")
    post(orders, "urgent", priority=1, now_s=13.0)
    orders.queue.move("b", 1, None, 14.0)
    assert [order.certain for order in orders.listed()] == [False, False, False]
    orders.accept(None, None, 16.0, known_s=11.0)
    assert not orders.listed()[0].certain, "it was asked for before the board was missed"
    orders.accept(None, None, 17.0)
    assert [order.certain for order in orders.listed()] == [True, True, True]


def test_what_the_line_was_armed_with_is_for_boards_without_an_order(orders: Orders) -> None:
    orders.accept(an_order("of all"), 2, 20.0)
    post(orders, "a", now_s=21.0)
    assert [orders.take(t, granted=ORDER).board_id for t in (22.0, 23.0, 24.0)] == ["a", "of all", "of all"]  # type: ignore[union-attr]
    assert (orders.runs_left, orders.wants_more) == (0, False)
    post(orders, "b", now_s=25.0)
    assert orders.next is not None, "an order that is given later is filmed nevertheless"


def test_boards_of_uncertain_order_count_as_runs_too(orders: Orders) -> None:
    orders.accept(ORDER, 1, 20.0)
    orders.queue.by_messages = True
    taken = orders.take(22.0, granted=ORDER)
    assert taken is not None
    assert (taken.board_id, orders.runs_left) == (None, 0), "no message announced it, yet it is filmed"


def test_a_board_before_every_order_has_none(orders: Orders) -> None:
    post(orders, "a", now_s=20.0)
    taken = orders.take(19.0, "r", ORDER)
    assert taken is not None
    assert (taken.board_id, orders.uncertain) == (None, "it had reached the barrier before an order was given")
    assert ids(orders) == ["a"]


def announce(orders: Orders, name: str, made: Order | None = None, now_s: float = 100.0, **more: Any) -> None:
    orders.queue.listen(True, 0.0)
    orders.queue.announce(1, LineBoard(name, **more), made, now_s)
    orders.queue.started(1, now_s)


def test_an_announced_board_takes_the_order_that_names_it_or_its_code(orders: Orders) -> None:
    post(orders, "a")
    post(orders, "code of b")
    announce(orders, "guid of b", barcodes=("code of b",))
    assert [(s.queued.id, s.coming) for s in orders.queue.shown()] == [("code of b", True), ("a", False)]
    assert orders.queue.refusals(1, None)[0].code == "board-in-gap"
    taken = orders.take(103.0, "r1", ORDER)
    assert taken is not None
    assert (taken.board_id, orders.uncertain, ids(orders)) == ("code of b", "", ["a"])
    assert orders.queue.board_of_run("r1") == LineBoard("guid of b", ("code of b",))


def test_the_product_of_a_board_makes_its_order(orders: Orders) -> None:
    post(orders, "a")
    announce(orders, "guid", an_order(board_type="large"))
    assert orders.next is not None
    assert orders.next.board_type.name == "large"
    taken = orders.take(103.0, "r1", ORDER)
    assert taken is not None
    assert (taken.board_type.name, taken.board_id) == ("large", "guid")


@pytest.mark.parametrize(
    ("edge_s", "why"),
    [(101.0, "no message of the line had announced it"), (104.0, "the boards 'a' and 'b' were on their way")],
)
def test_a_board_that_may_be_none_or_one_of_two_has_no_id(orders: Orders, edge_s: float, why: str) -> None:
    announce(orders, "a", ORDER)
    announce(orders, "b", ORDER, now_s=101.0)
    taken = orders.take(edge_s, "r1", ORDER)
    assert taken is not None
    assert taken.board_id is None
    assert orders.uncertain.startswith(why)


def test_a_board_that_was_taken_off_by_hand_gives_its_order_back(orders: Orders) -> None:
    post(orders, "a")
    announce(orders, "a")
    assert orders.queue.expire(100.0 + LONGEST_S + LATE_S) == []
    assert [board.name for board in orders.queue.expire(100.1 + LONGEST_S + LATE_S)] == ["a"]
    assert ids(orders) == ["a"]
    assert orders.queue.refusals(1, None) == ()


@pytest.mark.parametrize(
    ("board", "code"),
    [(LineBoard("a", product="P1"), "board-without-order"), (LineBoard("a", side="bottom"), "board-flipped")],
)
def test_a_board_without_an_order_or_with_the_wrong_side_up_is_not_sent(
    orders: Orders, board: LineBoard, code: str
) -> None:
    orders.queue.announce(1, board, ORDER if board.side else None, 100.0)
    assert [reason.code for reason in orders.queue.refusals(1, None)] == [code]


def test_a_product_without_a_board_type_takes_no_order_that_does_not_name_its_board(orders: Orders) -> None:
    orders.queue.add(Queued("any", an_order()), 11.0)
    orders.queue.listen(True, 0.0)
    for product, codes in (("unknown", ["board-without-order"]), ("", [])):
        orders.queue.announce(1, LineBoard("a", product=product), None, 100.0)
        assert [reason.code for reason in orders.queue.refusals(1, None)] == codes


def test_a_product_that_cannot_be_used_is_not_filmed_as_what_the_line_was_armed_with(orders: Orders) -> None:
    orders.accept(ORDER, None, 20.0)
    announce(orders, "a", product="P", unusable=True)
    taken = orders.take(103.0, "r1", ORDER)
    assert taken is not None
    assert (taken.board_id, orders.uncertain) == (None, "no order was for board 'a'")
    orders.queue.announce(1, LineBoard("b", product="P", unusable=True), None, 104.0)
    assert [reason.code for reason in orders.queue.refusals(1, ORDER)] == ["board-without-order"]


def test_a_board_that_comes_after_its_time_does_not_get_the_id_of_the_next_one(orders: Orders) -> None:
    announce(orders, "late", ORDER)
    assert [board.name for board in orders.queue.expire(112.0)] == ["late"]
    announce(orders, "next", ORDER, now_s=112.5)
    taken = orders.take(115.0, "r1", ORDER)  # it is the late one
    assert taken is not None
    assert taken.board_id is None
    assert orders.uncertain == "board 'late' did not reach the barrier in time, and may come later"


def test_a_board_whose_place_a_late_one_took_is_waited_for(orders: Orders) -> None:
    announce(orders, "late", ORDER)
    orders.queue.expire(112.0)
    announce(orders, "next", ORDER, now_s=117.0)
    assert orders.take(119.1, "r1", ORDER).board_id is None  # type: ignore[union-attr]
    assert [reason.code for reason in orders.queue.refusals(1, ORDER)] == ["board-in-gap"]
    announce(orders, "third", ORDER, now_s=120.0)  # a machine that does not wait
    assert orders.take(122.5, "r2", ORDER).board_id is None, "it is the next one"  # type: ignore[union-attr]
    orders.queue.expire(125.0)
    assert orders.queue.refusals(1, ORDER) == ()
    announce(orders, "fourth", ORDER, now_s=125.0)
    assert orders.take(128.0, "r3", ORDER).board_id == "fourth"  # type: ignore[union-attr]


def test_the_orders_of_boards_on_their_way_follow_the_calibration(orders: Orders) -> None:
    post(orders, "a")
    announce(orders, "a")
    assert [order.board_id for order in orders.queue.stale("new")] == ["a"]
    orders.queue.remake({"small": replace(ORDER, calibration_digest="new")}, 101.0)
    assert orders.queue.stale("new") == []
    taken = orders.take(103.0, "r1", ORDER)
    assert taken is not None
    assert (taken.board_id, taken.calibration_digest) == ("a", "new")


def test_a_board_of_uncertain_order_skips_no_positions_and_has_no_flip(orders: Orders) -> None:
    orders.queue.listen(True, 0.0)
    taken = orders.take(100.0, "r1", replace(ORDER, board_id="a", job_id="J", skip=("2",), flip="x"))
    assert taken is not None
    assert (taken.board_id, taken.job_id, taken.skip, taken.flip) == (None, None, (), None)
