"""Orders of the held station: the real queue and its requests, in the thread of the caller."""

from __future__ import annotations

from collections.abc import Callable
from types import SimpleNamespace
from typing import Any

from vaoi_station.model import BoardType
from vaoi_station.runs.control.order_requests import OrderRequests
from vaoi_station.runs.run.order import Order
from vaoi_station.runs.run.orders import Orders
from vaoi_station.stitching.work import StitchSetup


class _Inbox:
    """Calls at once what it is asked."""

    def ask(self, work: Callable[..., Any]) -> Any:
        return work()


def _order(board_type: BoardType, board_id: str | None, job_id: str | None) -> Order:
    setup = StitchSetup((), (0.0, 100.0), 0.1, board_type)
    return Order(board_type, board_id, job_id, setup, board_type.name, "calibration", "filmed")


def held_orders(board_type: Callable[[str], BoardType]) -> OrderRequests:
    """Return the requests of a queue that no line follows."""
    line = SimpleNamespace(orders=Orders(), follow=lambda: None)
    core: Any = SimpleNamespace(line=line, watch=SimpleNamespace(digest="calibration"))
    inbox: Any = _Inbox()
    return OrderRequests(inbox, core, _order, board_type, tuple)
