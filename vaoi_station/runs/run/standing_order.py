"""What the line was armed with, and the orders that wait, stored: a restart takes them up, or shows why not."""

from __future__ import annotations

from collections.abc import Callable
from dataclasses import dataclass, replace

from pydantic import BaseModel, ConfigDict, TypeAdapter, ValidationError

from vaoi_station.errors import VaoiError
from vaoi_station.model import BoardType, Reason
from vaoi_station.runs.run.order import Order
from vaoi_station.runs.run.order_queue import Queued
from vaoi_station.runs.states.schemas import FlipAxis
from vaoi_station.store.documents import KeyedTexts

_KEY, _WAITING_KEY = "armed", "orders"
_POST_AGAIN = "Then post it again."


class _Armed(BaseModel):
    """The order in the form in which it is stored."""

    model_config = ConfigDict(frozen=True)

    board_type: str | None
    """None: the line was armed for the waiting orders."""
    board_id: str | None = None
    job_id: str | None = None
    runs: int | None = None
    allow_lost_cameras: bool = False


class _Waiting(BaseModel):
    """A waiting order in the form in which it is stored."""

    model_config = ConfigDict(frozen=True)

    id: str
    board_type: str
    board_id: str | None = None
    job_id: str | None = None
    skip: tuple[str, ...] = ()
    flip: FlipAxis | None = None
    priority: int = 0
    allow_lost_cameras: bool = False
    created: str = ""


_ALL_WAITING = TypeAdapter(tuple[_Waiting, ...])


@dataclass(frozen=True)
class Resumed:
    """What was in force before a restart, ready to be armed again, or why it cannot be; and the orders that waited."""

    order: Order | None
    runs: int | None
    fault: Reason | None = None
    by_orders: bool = False
    waiting: tuple[Queued, ...] = ()
    lost: tuple[Reason, ...] = ()
    """Why orders that waited cannot be made again."""


class StandingOrder:
    """Stores the order in force in the database. Callers do not wait for the disk."""

    def __init__(self, documents: KeyedTexts) -> None:
        self._documents = documents
        self._waiting: tuple[str, ...] | None = None
        """Ids of the waiting orders as stored last; None if none were stored since the start."""

    def keep(self, order: Order | None, runs: int | None, *, by_orders: bool = False) -> None:
        """Store an order, with the number of boards still to be filmed for it; None deletes the stored one."""
        if order is None and not by_orders:
            self._documents.set(_KEY, None)
            return
        armed = _Armed(board_type=None)
        if order is not None:
            armed = _Armed(
                board_type=order.board_type.name,
                board_id=order.board_id,
                job_id=order.job_id,
                runs=runs,
                allow_lost_cameras=order.despite_lost_cameras,
            )
        self._documents.set(_KEY, armed.model_dump_json())

    def keep_waiting(self, waiting: tuple[Queued, ...]) -> None:
        """Store the orders that wait, if they have changed."""
        ids = tuple(f"{queued.id} {queued.priority}" for queued in waiting)
        if ids == (self._waiting or ()):
            return
        self._waiting = ids
        kept = tuple(
            _Waiting(
                id=queued.id,
                board_type=queued.order.board_type.name,
                board_id=queued.order.board_id,
                job_id=queued.order.job_id,
                skip=queued.order.skip,
                flip=queued.order.flip,
                priority=queued.priority,
                allow_lost_cameras=queued.order.despite_lost_cameras,
                created=queued.created,
            )
            for queued in waiting
        )
        self._documents.set(_WAITING_KEY, _ALL_WAITING.dump_json(kept).decode() if kept else None)

    def resume(
        self,
        get_board_type: Callable[[str], BoardType],
        make_order: Callable[[BoardType, str | None, str | None], Order],
    ) -> Resumed | None:
        """Make the orders from when the station ended again; None if the line was not armed, and no order waited."""
        waiting, lost = self._resume_waiting(get_board_type, make_order)
        order, runs, fault, by_orders = None, None, None, False
        if (document := self._documents.get(_KEY)) is not None:
            try:
                armed = _Armed.model_validate_json(document)
                runs, by_orders = armed.runs, armed.board_type is None
                if armed.board_type is not None and runs != 0:
                    order = make_order(get_board_type(armed.board_type), armed.board_id, armed.job_id)
                    order = replace(order, despite_lost_cameras=armed.allow_lost_cameras)
            except (ValidationError, VaoiError) as error:
                why, action = "the order cannot be read", "Arm the line."
                if isinstance(error, VaoiError):
                    why, action = error.message, f"{error.action} Then arm the line.".strip()
                message = f"The line was armed before the restart and is not armed now: {why}"
                fault = Reason(code="not-armed-again", message=message, action=action)
        resumed = Resumed(order, runs, fault, by_orders, waiting, lost)
        return resumed if order or fault or by_orders or waiting or lost else None

    def _resume_waiting(
        self,
        get_board_type: Callable[[str], BoardType],
        make_order: Callable[[BoardType, str | None, str | None], Order],
    ) -> tuple[tuple[Queued, ...], tuple[Reason, ...]]:
        """Make the orders again that waited when the station ended; return them, and why others cannot be made."""
        document = self._documents.get(_WAITING_KEY)
        try:
            stored = () if document is None else _ALL_WAITING.validate_json(document)
        except ValidationError:
            return (), (Reason(code="order-lost", message="The waiting orders cannot be read.", action=_POST_AGAIN),)
        made, waiting, lost = dict[str, Order](), [], []
        for kept in stored:
            try:
                name = kept.board_type
                if name not in made:
                    made[name] = make_order(get_board_type(name), None, None)
                order = made[name].for_board(kept.board_id, kept.job_id, kept.skip, kept.flip)
            except VaoiError as error:
                of = "without id" if kept.board_id is None else repr(kept.board_id)
                message = f"The order for board {of} of type {name!r} is lost: {error.message}"
                lost.append(Reason(code="order-lost", message=message, action=f"{error.action} {_POST_AGAIN}".strip()))
                continue
            order = replace(order, despite_lost_cameras=kept.allow_lost_cameras)
            waiting.append(Queued(kept.id, order, kept.priority, kept.created))
        return tuple(waiting), tuple(lost)
