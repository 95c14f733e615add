"""Requests to arm that wait: until a board has passed, or until the line is disarmed.

Of several requests that wait for the same, the newest order is put in force, and their callers receive the same reply.
If each order was put in force in turn, the order of a board that is already at the barrier would be forgotten.
"""

from __future__ import annotations

from concurrent.futures import Future
from functools import partial
from typing import NamedTuple

from vaoi_station.errors import VaoiError
from vaoi_station.runs.run.order import Order
from vaoi_station.runs.states.schemas import ArmedWith

Completion = Future[None]
"""A future that is set when a request has taken effect, or carries the refusal of the request."""


class WaitingRequest(NamedTuple):
    """A request to arm."""

    order: Order
    runs: int | None
    """Number of boards to film; None for no limit."""
    completion: Completion


class WaitingOrders:
    """The requests to arm that wait. Used by the coordinator's thread only."""

    def __init__(self) -> None:
        self._after_board: list[WaitingRequest] = []
        self._after_disarm: list[WaitingRequest] = []

    def wait_for_board(self, request: WaitingRequest) -> None:
        """Let a request wait until the board that passes, which keeps the order before, has left."""
        self._after_board.append(request)

    def wait_for_disarm(self, request: WaitingRequest) -> None:
        """Let a request wait until the line is disarmed, because the Disarm under way would undo it."""
        self._after_disarm.append(request)

    def withdraw(self, completion: Completion) -> bool:
        """Withdraw a request that waits for a board. Return False if it does not wait for one any more."""
        kept = [request for request in self._after_board if request.completion is not completion]
        waited, self._after_board = len(kept) < len(self._after_board), kept
        return waited

    def refuse(self, refusal: VaoiError) -> None:
        """Refuse all requests that wait."""
        for request in [*self._after_board, *self._after_disarm]:
            request.completion.set_exception(refusal)
        self._after_board, self._after_disarm = [], []

    def board_left(self) -> WaitingRequest | None:
        """Return the request to serve now that the board has left; None if none waited for it."""
        waiting, self._after_board = self._after_board, []
        return _newest(waiting)

    def disarmed(self) -> WaitingRequest | None:
        """Return the request to serve now that the line is disarmed and no board passes; None if none waited."""
        waiting = [*self._after_board, *self._after_disarm]
        self._after_board, self._after_disarm = [], []
        return _newest(waiting)

    @property
    def next_order(self) -> ArmedWith | None:
        """The order that takes effect when the board that passes has left; None if there is none."""
        if not self._after_board:
            return None
        request = self._after_board[-1]
        return request.order.shown(request.runs)


def _newest(waiting: list[WaitingRequest]) -> WaitingRequest | None:
    """Return the newest request, on whose completion that of the others depends."""
    if not waiting:
        return None
    *replaced, newest = waiting
    for request in replaced:
        newest.completion.add_done_callback(partial(_follow, request.completion))
    return newest


def _follow(other: Completion, done: Completion) -> None:
    """Complete a request as another one was completed."""
    refusal = done.exception()
    if refusal is None:
        other.set_result(None)
    else:
        other.set_exception(refusal)
