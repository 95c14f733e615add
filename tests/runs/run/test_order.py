"""Orders: which board gets which, what restarts take up again, and board types that are refused."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from vaoi_station.config import StationConfig
from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.model import BoardType, Calibration, Visibility
from vaoi_station.runs.run.order import Order, OrderFactory
from vaoi_station.runs.run.orders import Orders
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.run.reference_store import ReferenceStore
from vaoi_station.runs.run.standing_order import StandingOrder
from vaoi_station.store import Store


def make_desk(config: StationConfig, calibration: Calibration, store: Store) -> OrderFactory:
    shelf = ReferenceStore(config.data / "references", store, calibration.cameras(config.heads))
    return OrderFactory(config, calibration, store, shelf)


@pytest.fixture
def desk(config: StationConfig, calibration: Calibration, store: Store) -> OrderFactory:
    return make_desk(config, calibration, store)


@pytest.fixture
def orders_by_id(progress: Progress) -> dict[str, Order]:
    return {name: replace(progress.order, board_id=name) for name in "abcd"}


def test_a_board_gets_the_order_that_was_in_force_at_its_edge(orders_by_id: dict[str, Order]) -> None:
    """An order that is repeated, corrected or cancelled while a board waits is for the next one."""
    orders, of = Orders(), orders_by_id
    assert orders.take(0.0) is None
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
    orders.take(25.0)
    orders.take(26.0)
    assert not orders.wants_more
    orders.cancel(30.0)
    orders.cancel(31.0)
    assert orders.shown() is None
    assert orders.take(29.0) is of["d"], "it was under the barrier when the line was disarmed"


def test_a_board_that_waits_longer_than_orders_are_kept_has_no_certain_id(orders_by_id: dict[str, Order]) -> None:
    orders = Orders()
    for n in range(30):
        orders.accept(orders_by_id["b"], None, 10.0 + n)
    orders.take(10.5)
    assert orders.doubt_of(orders.taken_since_s, 10.5) == "more orders were given while it waited than are kept"
    assert orders.doubt_of(39.0, 45.0) is None


def test_a_board_type_brings_its_lights_and_its_speed(
    config: StationConfig, calibration: Calibration, store: Store, board_type: BoardType
) -> None:
    limits = config.line.model_copy(update={"speed_limits_mm_s": (50.0, 200.0)})
    asked = Visibility(in_one_frame=True)
    desk = make_desk(config.model_copy(update={"line": limits, "visibility": asked}), calibration, store)
    steps = [{"light": "left"}, {"light": "right"}]
    changed = BoardType.model_validate({**board_type.model_dump(), "program": steps, "line": {"speed_mm_s": 50.0}})
    order = desk(changed, None, None)
    assert order.plan is not None
    assert order.line is not None
    assert (order.setup.lights, order.plan.lights) == (("left", "right"),) * 2
    assert order.setup.conveyor_mm_s == order.line.conveyor_mm_s == (0.0, 50.0)
    assert order.setup.trigger_period_s == order.plan.period_s == 2 * config.line.trigger_period_s
    assert order.setup.visibility == asked, "that of the station"
    fast = BoardType.model_validate({**board_type.model_dump(), "line": {"speed_mm_s": 500.0}})
    with pytest.raises(InputError, match=r"line\.speed_mm_s is 500\.0, but must be"):
        desk(fast, None, None)


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


def test_what_boards_of_one_type_have_in_common_is_made_once(
    desk: OrderFactory, board_type: BoardType, calibration: Calibration
) -> None:
    first, second = desk(board_type, "a", "J1"), desk(board_type, "b", None)
    assert second.setup is first.setup
    assert (first.board_id, first.job_id, second.board_id, second.job_id) == ("a", "J1", "b", None)
    assert desk(board_type.model_copy(), "c", None).setup is not first.setup, "a file that was read again"
    desk.use_calibration(calibration.model_copy(update={"created": "2026-02-01T00:00:00Z"}))
    later = desk(board_type, "d", None)
    assert later.setup is not first.setup
    assert later.calibration_digest != first.calibration_digest
