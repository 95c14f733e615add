"""Orders that wait, on a line: each board takes its own, and the line is set for the next one."""

from __future__ import annotations

import time
from concurrent.futures import Future, ThreadPoolExecutor
from typing import Any

import numpy as np
import pytest

from tests.runs.peer import PATIENCE_S
from vaoi_station.acquisition.process import messages
from vaoi_station.errors import InputError, StateError
from vaoi_station.files import write_board_type
from vaoi_station.model import BoardType
from vaoi_station.model.board_identity import IdentityDocument
from vaoi_station.runs.control.core import Core
from vaoi_station.runs.control.order_requests import WantedOrder
from vaoi_station.runs.run.order_queue import LineBoard, Queued
from vaoi_station.runs.run.standing_order import StandingOrder


def armed(rig: Any, *, grant: bool = True) -> Any:
    """Arm for the orders that wait, playing the other side."""
    with ThreadPoolExecutor(1) as caller:
        outcome = caller.submit(rig.coordinator.arm, None)
        granted = rig.peer.expect(messages.Grant) if grant else None
        rig.peer.expect(messages.Arm)
        rig.peer.report(messages.Armed())
        outcome.result(PATIENCE_S)
    return granted


def post(rig: Any, board_id: str | None, **more: Any) -> Any:
    return rig.coordinator.orders.add(WantedOrder("small", board_id, "J1", **more))


def codes(rig: Any) -> list[str]:
    return [event.code for event in rig.coordinator.events()]


def test_boards_take_their_orders_and_a_board_without_one_is_missed_visibly(rig: Any) -> None:
    armed(rig, grant=False)
    assert [reason.code for reason in rig.coordinator.snapshot().line_held] == ["no-order"]
    post(rig, "b1", flip="x")
    post(rig, "b2")
    first = rig.peer.expect(messages.Grant)
    snapshot = rig.coordinator.snapshot()
    assert (snapshot.armed_with.board_id, [o.board_id for o in snapshot.orders]) == ("b1", ["b1", "b2"])
    rig.board(first)
    second = rig.peer.expect(messages.Grant)
    assert (rig.result_of(first.run).board_id, rig.result_of(first.run).job_id) == ("b1", "J1")
    rig.board(second)
    assert rig.result_of(second.run).board_id == "b2"
    assert [rig.result_of(grant.run).flip for grant in (first, second)] == ["x", None]
    assert rig.coordinator.snapshot().orders_waiting == 0
    rig.peer.report(messages.BoardMissed(time.monotonic(), "no memory was free for its frames"))
    rig.wait_for(lambda: "board-without-order" in codes(rig), "the missed board")
    [event] = [event for event in rig.coordinator.events() if event.code == "board-without-order"]
    assert event.message == "A board passed and was not filmed: no order waited for it"
    assert rig.coordinator.snapshot().state == "armed"


def test_a_board_that_was_turned_over_is_expected_as_the_axis_of_the_flip_lets_it_lie(rig: Any) -> None:
    """CAD "up" points up in the image, along the tester's y: it stays so about y, and is reversed about x."""
    lies = {}
    for axis, board in (("x", "b1"), ("y", "b2"), (None, "b3")):
        post(rig, board, flip=axis)
        [order] = [q.order for q in rig.coordinator._core.line.orders.queue.kept if q.order.board_id == board]
        lies[axis] = order.line.expected_board.rotation_deg
        assert order.setup.expectation.angle_rad == -np.radians(lies[axis])
        assert order.for_board(None, None).line.expected_board.rotation_deg == 0
    assert lies == {"x": 180, "y": 0, None: 0}
    first = armed(rig)
    rig.board(first)
    terms = rig.result_of(first.run).made_with.terms
    assert terms.expected_board.rotation_deg == 180
    assert rig.coordinator.finished(first.run).head.rotation_deg == 180


def test_the_order_that_a_product_makes_has_nothing_of_one_that_waits(rig: Any) -> None:
    post(rig, "b1", flip="x", allow_lost_cameras=True)
    rig.coordinator.orders.announce(1, LineBoard("b7", product="P1", board_type="small"))
    made = rig.coordinator._core.line.orders.queue.next(None)
    assert (made.board_id, made.job_id, made.flip, made.despite_lost_cameras) == (None, None, None, False)
    assert made.line.expected_board.rotation_deg == 0


def test_after_a_missed_board_no_order_is_certain_until_the_line_is_armed_again(rig: Any) -> None:
    post(rig, "b1")
    post(rig, "b2")
    grant = armed(rig)
    rig.peer.report(messages.BoardMissed(time.monotonic(), "it came too early"))
    rig.wait_for(lambda: rig.coordinator.snapshot().boards_missed == 1, "the missed board")
    assert [order.certain for order in rig.coordinator.orders.list().orders] == [False, False]
    assert "board-id-uncertain" in [warning.code for warning in rig.coordinator.snapshot().warnings]
    rig.board(grant)
    run = rig.result_of(grant.run)
    assert (run.board_id, [reason.code for reason in run.reasons]) == (None, ["board-id-uncertain"])
    rig.coordinator.arm(None)
    assert [order.certain for order in rig.coordinator.orders.list().orders] == [True]


def test_the_line_is_set_for_the_next_order_between_two_boards(rig: Any) -> None:
    other = rig.coordinator.board_type("small").model_dump() | {"name": "slow", "line": {"longest_board_mm": 40.0}}
    write_board_type(rig.config.board_types / "slow.json", BoardType.model_validate(other))
    post(rig, "b1")
    grant = armed(rig)
    rig.coordinator.orders.add(WantedOrder("slow", "b2"))
    rig.board(grant)
    rig.peer.expect(messages.Disarm)
    rig.peer.report(messages.Disarmed(()))
    following = rig.peer.expect(messages.Grant)
    plan = rig.peer.expect(messages.Arm).plan
    rig.peer.report(messages.Armed())
    assert plan.max_rows < rig.coordinator._core.line._plan_of(None).max_rows
    rig.until("armed")
    rig.board(following)
    run = rig.result_of(following.run)
    assert (run.board_type, run.board_id) == ("slow", "b2")


def test_arming_for_orders_takes_no_leave_to_film_without_cameras(rig: Any) -> None:
    with pytest.raises(InputError, match="stated by each order that waits"):
        rig.coordinator.arm(None, allow_lost_cameras=True)


def test_after_the_last_board_of_an_armed_number_an_order_that_waits_arms_the_line(rig: Any) -> None:
    other = rig.coordinator.board_type("small").model_dump() | {"name": "slow", "line": {"longest_board_mm": 40.0}}
    write_board_type(rig.config.board_types / "slow.json", BoardType.model_validate(other))
    with ThreadPoolExecutor(1) as caller:
        outcome = caller.submit(rig.coordinator.arm, "small", None, None, 1)
        granted = rig.peer.expect(messages.Grant)
        rig.peer.expect(messages.Arm)
        rig.peer.report(messages.Armed())
        outcome.result(PATIENCE_S)
    line = rig.coordinator._core.line
    made, take_grant = rig.coordinator._make_order(rig.coordinator.board_type("slow"), "b2", None), line.take_grant

    def given_meanwhile(*a: Any) -> Any:
        taken = take_grant(*a)
        line.orders.queue.add(Queued("o2", made), time.monotonic())
        return taken

    line.take_grant = given_meanwhile
    rig.board(granted)
    rig.peer.expect(messages.Disarm)
    rig.peer.report(messages.Disarmed(()))
    rig.peer.expect(messages.Grant)
    rig.peer.expect(messages.Arm)


def test_a_board_that_a_neighbour_announced_takes_the_order_with_its_id(rig: Any) -> None:
    orders = rig.coordinator.orders
    post(rig, "b1")
    post(rig, "b2")
    grant = armed(rig)
    rig.coordinator._core.line.orders.queue.listen(True, 0.0)
    orders.announce(1, LineBoard("guid", ("b2",)))
    assert "board-in-gap" not in [reason.code for reason in orders.may_accept(1)]
    orders.started(1)
    assert [(o.board_id, o.state) for o in orders.list().orders] == [("b2", "coming"), ("b1", "waiting")]
    assert "board-in-gap" in [reason.code for reason in orders.may_accept(1)]
    rig.board(grant)
    assert rig.result_of(grant.run).board_id == "b2"
    assert orders.board_of_run(grant.run) == LineBoard("guid", ("b2",))
    unknown = rig.peer.expect(messages.Grant)
    rig.board(unknown)
    run = rig.result_of(unknown.run)
    assert (run.board_id, [reason.code for reason in run.reasons]) == (None, ["order-uncertain"])
    assert [o.board_id for o in orders.list().orders] == ["b1"]


def test_a_code_that_belongs_to_a_waiting_order_shows_boards_out_of_step(rig: Any) -> None:
    post(rig, "b1")
    post(rig, "b2")
    grant = armed(rig)
    rig.board(grant)
    rig.result_of(grant.run)
    read = IdentityDocument(state="differs", board_id="b2", armed_board_id="b1", read=True)
    rig.coordinator.kept.on_identified(grant.run, read)
    rig.wait_for(lambda: "orders-out-of-step" in codes(rig), "the contradiction")
    assert [order.certain for order in rig.coordinator.orders.list().orders] == [False]


def test_waiting_orders_survive_a_restart_and_are_in_doubt(rig: Any) -> None:
    store = rig.store.standing
    rig.coordinator._core.line._standing = StandingOrder(store)
    post(rig, "b1", priority=3, flip="y")
    post(rig, None)
    armed(rig)
    rig.store.database.write(lambda _: None).result(10)
    resumed = StandingOrder(store).resume(rig.coordinator.board_type, rig.coordinator._make_order)
    assert resumed is not None
    assert resumed.by_orders
    assert [(q.order.board_id, q.order.job_id, q.priority, q.order.flip) for q in resumed.waiting] == [
        ("b1", "J1", 3, "y"),
        (None, "J1", 0, None),
    ]
    line = Core(rig.coordinator._parts).line
    line.resume(resumed)
    assert [(o.board_id, o.certain) for o in line.orders.listed()] == [("b1", False), (None, False)]
    line.disarm(Future())
    assert (len(line.orders.queue.waiting), line.orders.next) == (2, None), "orders wait while the line is disarmed"


def test_an_order_whose_board_type_is_gone_is_lost_with_a_message(rig: Any) -> None:
    store = rig.store.standing
    rig.coordinator._core.line._standing = StandingOrder(store)
    post(rig, "b1")
    rig.store.database.write(lambda _: None).result(10)
    with pytest.raises(StateError, match="orders for it wait"):
        rig.coordinator.delete_board_type("small")
    (rig.config.board_types / "small.json").unlink()
    resumed = StandingOrder(store).resume(rig.coordinator.board_type, rig.coordinator._make_order)
    assert resumed is not None
    [lost] = resumed.lost
    assert (lost.code, resumed.waiting) == ("order-lost", ())
    assert "The order for board 'b1' of type 'small' is lost" in lost.message


def test_what_an_order_skips_is_stored_with_the_recording_of_its_board(rig: Any) -> None:
    small = rig.coordinator.board_type("small").model_dump()
    parts = [{"ref": "U1", "center": (10, 10), "width": 4, "height": 4, "panel": panel} for panel in "12"]
    write_board_type(rig.config.board_types / "small.json", BoardType.model_validate(small | {"components": parts}))
    post(rig, "b1", skip=("2",))
    post(rig, "b2")
    first = armed(rig)
    rig.board(first)
    second = rig.peer.expect(messages.Grant)
    rig.board(second)
    kept = []
    for grant in (first, second):
        rig.result_of(grant.run)
        kept.append(rig.archive.get(grant.run).head.skip)
    assert kept == [("2",), None]
