"""Requests to arm that wait: which is served, and what the callers of the others receive."""

from __future__ import annotations

from dataclasses import replace

import pytest

from vaoi_station.errors import StateError
from vaoi_station.runs.run.order import Order
from vaoi_station.runs.run.progress import Progress
from vaoi_station.runs.run.waiting_orders import Completion, WaitingOrders, WaitingRequest


@pytest.fixture
def order(progress: Progress) -> Order:
    return progress.order


def request(order: Order, board_id: str) -> WaitingRequest:
    return WaitingRequest(replace(order, board_id=board_id), 1, Completion())


def test_the_newest_is_served_and_the_others_receive_its_reply(order: Order) -> None:
    waiting, requests = WaitingOrders(), [request(order, name) for name in "ABC"]
    for each in requests:
        waiting.wait_for_board(each)
    assert waiting.next_order is not None
    assert waiting.next_order.board_id == "C"
    served = waiting.board_left()
    assert served is requests[-1]
    assert waiting.board_left() is None
    assert not requests[0].completion.done()
    served.completion.set_exception(StateError("The station is faulted."))
    for each in requests:
        with pytest.raises(StateError, match="faulted"):
            each.completion.result(0)


def test_a_withdrawn_request_is_not_served(order: Order) -> None:
    waiting, first, second = WaitingOrders(), request(order, "A"), request(order, "B")
    waiting.wait_for_board(first)
    waiting.wait_for_disarm(second)
    assert waiting.withdraw(first.completion)
    assert not waiting.withdraw(second.completion)
    assert waiting.next_order is None
    assert waiting.disarmed() is second
    second.completion.set_result(None)
    assert not first.completion.done()


def test_all_that_wait_are_refused(order: Order) -> None:
    waiting, first, second = WaitingOrders(), request(order, "A"), request(order, "B")
    waiting.wait_for_board(first)
    waiting.wait_for_disarm(second)
    waiting.refuse(StateError("The line was disarmed."))
    for each in (first, second):
        with pytest.raises(StateError, match="was disarmed"):
            each.completion.result(0)
    assert waiting.disarmed() is None
