"""Orders: which board gets which, what restarts take up again, and board types that are refused."""

from __future__ import annotations

import pickle
import time
from collections.abc import Callable
from dataclasses import replace

import pytest

from vaoi_station.config import StationConfig
from vaoi_station.errors import InputError, NotFoundError, StateError
from vaoi_station.model import BoardType, Calibration, Visibility
from vaoi_station.runs.control.active_runs import camera_heads
from vaoi_station.runs.control.line_control import Rearming
from vaoi_station.runs.run.order import Order, OrderFactory, Orders, StandingOrder
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.run.reference_store import ReferenceStore
from vaoi_station.runs.run.run_views import made_with
from vaoi_station.store import Store


def order_of(desk: OrderFactory, board_type: BoardType, board_id: str) -> Order:
    return desk(board_type, board_id, None)


def make_desk(config: StationConfig, calibration: Calibration, store: Store) -> OrderFactory:
    heads = camera_heads(config)
    shelf = ReferenceStore(config.data / "references", store, calibration.cameras(heads))
    return OrderFactory(config, calibration, store, shelf)


def test_a_board_that_was_there_first_belongs_to_the_order_before(
    config: StationConfig, calibration: Calibration, store: Store, board_type: BoardType
) -> None:
    desk, orders = make_desk(config, calibration, store), Orders()
    first, second = order_of(desk, board_type, "b1"), order_of(desk, board_type, "b2")
    orders.accept(first, None, 10.0)
    assert orders.take(11.0) is first
    orders.accept(second, None, 20.0)
    assert orders.take(19.9) is first
    assert orders.take(20.1) is second


def test_orders_that_come_before_its_first_pulse_do_not_change_that_of_a_board(
    config: StationConfig, calibration: Calibration, store: Store, board_type: BoardType
) -> None:
    """An order that is repeated, corrected or cancelled while a board waits is for the next one."""
    desk, orders = make_desk(config, calibration, store), Orders()
    of = {name: order_of(desk, board_type, name) for name in "abcd"}
    orders.accept(of["a"], 1, 10.0)
    orders.accept(of["b"], None, 20.0)
    orders.cancel(21.0)
    orders.accept(of["c"], 2, 22.0)
    orders.accept(of["d"], 3, 23.0)
    assert orders.take(19.0) is of["a"]
    assert orders.taken_since_s == 10.0
    assert orders.take(20.5) is of["b"]
    assert orders.take(21.5) is of["b"], "it came while no order was in force"
    assert orders.take(22.5) is of["c"]
    assert orders.runs_left == 3, "boards of former orders do not count"
    assert orders.take(24.0) is of["d"]
    assert (orders.taken_since_s, orders.runs_left) == (23.0, 2)
    assert orders.references == set()


def test_a_board_that_waits_longer_than_orders_are_kept_has_no_certain_id(
    config: StationConfig, calibration: Calibration, store: Store, board_type: BoardType
) -> None:
    orders, order = Orders(), order_of(make_desk(config, calibration, store), board_type, "b")
    for n in range(30):
        orders.accept(order, None, 10.0 + n)
    orders.take(10.5)
    assert orders.doubt_of(orders.taken_since_s, 10.5) == "more orders were given while it waited than are kept"
    assert orders.doubt_of(39.0, 45.0) is None


def test_an_order_ends_after_its_number_of_runs(
    config: StationConfig, calibration: Calibration, store: Store, board_type: BoardType
) -> None:
    orders = Orders()
    orders.accept(order_of(make_desk(config, calibration, store), board_type, "b"), 2, 10.0)
    assert orders.wants_more
    orders.take(11.0)
    assert orders.wants_more
    shown = orders.shown()
    assert shown is not None
    assert (shown.board_id, shown.runs_left) == ("b", 1)
    orders.take(12.0)
    assert not orders.wants_more


def test_a_board_under_the_barrier_when_the_line_is_disarmed_keeps_its_order(
    config: StationConfig, calibration: Calibration, store: Store, board_type: BoardType
) -> None:
    orders, order = Orders(), order_of(make_desk(config, calibration, store), board_type, "b")
    assert orders.take(0.0) is None
    orders.accept(order, None, 10.0)
    orders.cancel(20.0)
    orders.cancel(21.0)
    assert not orders.wants_more
    assert orders.shown() is None
    assert orders.take(19.0) is order


def test_what_was_used_is_kept_with_its_digest(
    config: StationConfig, calibration: Calibration, store: Store, board_type: BoardType
) -> None:
    order = order_of(make_desk(config, calibration, store), board_type, "b")
    assert BoardType.model_validate_json(store.document(order.board_type_digest)) == board_type
    kept = Calibration.model_validate_json(store.document(order.calibration_digest))
    assert len(kept.cameras(camera_heads(config))) == len(order.setup.cameras) == 2


def test_a_board_type_with_one_fiducial_is_not_armed(
    config: StationConfig, calibration: Calibration, store: Store, board_type: BoardType
) -> None:
    """A file in the directory of board types may be older than this rule."""
    with pytest.raises(InputError, match="has 1 fiducial, but must have at least 2"):
        make_desk(config, calibration, store)(
            board_type.model_copy(update={"fiducials": board_type.fiducials[:1]}), None, None
        )


def test_an_order_asks_for_what_the_station_asks_for(
    config: StationConfig, calibration: Calibration, store: Store, board_type: BoardType
) -> None:
    heads = camera_heads(config)
    shelf = ReferenceStore(config.data / "references", store, calibration.cameras(heads))
    asked = Visibility(in_one_frame=True)
    desk = OrderFactory(config.model_copy(update={"visibility": asked}), calibration, store, shelf)
    assert desk(board_type, None, None).setup.visibility == asked


def test_a_board_type_brings_its_lights_and_its_speed(
    config: StationConfig, calibration: Calibration, store: Store, board_type: BoardType
) -> None:
    limits = config.line.model_copy(update={"speed_limits_mm_s": (50.0, 200.0)})
    desk = make_desk(config.model_copy(update={"line": limits}), calibration, store)
    steps = [{"light": "left"}, {"light": "right"}]
    changed = BoardType.model_validate({**board_type.model_dump(), "program": steps, "line": {"speed_mm_s": 50.0}})
    order = desk(changed, None, None)
    assert order.plan is not None
    assert order.line is not None
    assert (order.setup.lights, order.plan.lights) == (("left", "right"),) * 2
    assert order.setup.conveyor_mm_s == order.line.conveyor_mm_s == (0.0, 50.0)
    assert order.setup.trigger_period_s == order.plan.period_s == 2 * config.line.trigger_period_s


def test_a_board_type_outside_the_limits_is_not_armed(
    config: StationConfig, calibration: Calibration, store: Store, board_type: BoardType
) -> None:
    fast = BoardType.model_validate({**board_type.model_dump(), "line": {"speed_mm_s": 500.0}})
    with pytest.raises(InputError, match=r"line\.speed_mm_s is 500\.0, but must be"):
        make_desk(config, calibration, store)(fast, None, None)


def test_a_draft_is_armed_with_a_warning_and_a_retired_board_type_is_not(
    config: StationConfig, calibration: Calibration, store: Store, board_type: BoardType
) -> None:
    desk = make_desk(config, calibration, store)
    draft = order_of(desk, board_type.model_copy(update={"state": "draft", "revision": "B"}), "b")
    assert [note.code for note in draft.notes] == ["board-type-draft"]
    made = made_with(draft)
    assert (made.board_type_revision, made.board_type_state) == ("B", "draft")
    approved = order_of(desk, board_type.model_copy(update={"state": "approved"}), "b")
    assert (approved.notes, approved.draft) == ((), None)
    with pytest.raises(StateError, match="is retired"):
        order_of(desk, board_type.model_copy(update={"state": "retired"}), "b")


def test_an_order_is_ready_to_be_sent_to_the_workers(
    config: StationConfig, calibration: Calibration, store: Store, board_type: BoardType
) -> None:
    parts = [board_type.components[0].model_copy(update={"ref": f"R{n}"}) for n in range(3000)]
    order = order_of(
        make_desk(config, calibration, store), board_type.model_copy(update={"components": tuple(parts)}), "b"
    )
    began_s = time.thread_time()
    pickle.dumps(order.setup)
    sent_s = time.thread_time()
    pickle.dumps(order.board_type)
    assert sent_s - began_s < (time.thread_time() - sent_s) / 5, "what takes long was done when the line was armed"


@pytest.fixture
def order(progress: Progress) -> Order:
    return replace(progress.order, board_id="b 1", job_id="j 1", despite_lost_cameras=True)


@pytest.fixture
def make(order: Order) -> Callable[[BoardType, str | None, str | None], Order]:
    return lambda board_type, board_id, job_id: replace(
        order, board_type=board_type, board_id=board_id, job_id=job_id, despite_lost_cameras=False
    )


def settle(store: Store) -> None:
    store.database.write(lambda _: None).result(10)


def test_an_order_is_taken_up_as_it_was(store: Store, order: Order, make: Callable[..., Order]) -> None:
    standing = StandingOrder(store.standing)
    assert standing.resume(lambda _: order.board_type, make) is None
    standing.keep(order, 4)
    settle(store)
    resumed = StandingOrder(store.standing).resume(lambda _: order.board_type, make)
    assert resumed is not None
    assert (resumed.order, resumed.runs, resumed.fault) == (order, 4, None)
    standing.keep(None, None)
    settle(store)
    assert standing.resume(lambda _: order.board_type, make) is None


def test_an_order_that_cannot_be_made_any_more_is_explained(
    store: Store, order: Order, make: Callable[..., Order]
) -> None:
    def unknown(name: str) -> BoardType:
        raise NotFoundError(f"There is no board type {name!r}.", action="Store it.")

    standing = StandingOrder(store.standing)
    standing.keep(order, None)
    settle(store)
    resumed = standing.resume(unknown, make)
    assert resumed is not None
    assert resumed.fault is not None
    assert resumed.order is None
    assert resumed.fault.code == "not-armed-again"
    assert "There is no board type 'small'" in resumed.fault.message
    assert resumed.fault.action == "Store it. Then arm the line."


def test_a_record_of_another_version_and_a_finished_order_arm_nothing(
    store: Store, order: Order, make: Callable[..., Order]
) -> None:
    standing = StandingOrder(store.standing)
    standing.keep(order, 0)
    settle(store)
    assert standing.resume(lambda _: order.board_type, make) is None
    store.standing.set("armed", "{}").result(10)
    resumed = standing.resume(lambda _: order.board_type, make)
    assert resumed is not None
    assert resumed.fault is not None


def test_the_pauses_between_attempts_to_arm_again_grow_to_a_limit() -> None:
    now = [0.0]
    rearming = Rearming(lambda: now[0])
    due = []
    for pause_s in (2.0, 4.0, 8.0, 16.0, 30.0, 30.0):
        rearming.fail("camera c0 is lost", "Check its cable.")
        now[0] += pause_s - 0.1
        due.append(rearming.is_due)
        now[0] += 0.2
        due.append(rearming.is_due)
    assert due == [False, True] * 6
    assert rearming.why is not None
    assert rearming.why.action == "Check its cable. The station tries again by itself."
    assert (rearming.succeed(), rearming.succeed(), rearming.is_due) == (True, False, True)
