"""The order that a restart takes up again."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import replace

import pytest

from vaoi_station.errors import NotFoundError
from vaoi_station.model import BoardType
from vaoi_station.runs.run.order import Order
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.run.standing_order import Rearming, StandingOrder
from vaoi_station.store import Store


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
    standing.drop()
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
