"""The order in force, stored for a restart: the line is armed again with it, or the reason why not is shown."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass, replace

from pydantic import BaseModel, ConfigDict, ValidationError

from vaoi_station.backoff import Backoff, BackoffPolicy
from vaoi_station.errors import VaoiError
from vaoi_station.model import BoardType
from vaoi_station.runs.run.order import Order
from vaoi_station.runs.states.schemas import Reason
from vaoi_station.store.standing import StandingDocuments

_KEY = "armed"
CODE = "not-armed-again"
PACE = BackoffPolicy(first_s=2.0, longest_s=30.0, proven_s=30.0)
"""Pauses between attempts of the station to arm the line again by itself."""


class _Armed(BaseModel):
    """The order in the form in which it is stored."""

    model_config = ConfigDict(frozen=True)

    board_type: str
    board_id: str | None = None
    job_id: str | None = None
    runs: int | None = None
    allow_lost_cameras: bool = False


@dataclass(frozen=True)
class Resumed:
    """The order that was in force before a restart, ready to be armed again, or the reason why it cannot be."""

    order: Order | None
    runs: int | None
    fault: Reason | None = None


class StandingOrder:
    """Stores the order in force in the database. Callers do not wait for the disk."""

    def __init__(self, documents: StandingDocuments) -> None:
        self._documents = documents

    def keep(self, order: Order, runs: int | None) -> None:
        """Store an order, with the number of boards that are still to be filmed for it."""
        armed = _Armed(
            board_type=order.board_type.name,
            board_id=order.board_id,
            job_id=order.job_id,
            runs=runs,
            allow_lost_cameras=order.despite_lost_cameras,
        )
        self._documents.set(_KEY, armed.model_dump_json())

    def drop(self) -> None:
        """Delete the stored order, because the line was disarmed."""
        self._documents.set(_KEY, None)

    def resume(
        self,
        get_board_type: Callable[[str], BoardType],
        make_order: Callable[[BoardType, str | None, str | None], Order],
    ) -> Resumed | None:
        """Make the order that was in force when the station ended again; None if the line was not armed."""
        document = self._documents.get(_KEY)
        if document is None:
            return None
        try:
            armed = _Armed.model_validate_json(document)
            order = make_order(get_board_type(armed.board_type), armed.board_id, armed.job_id)
        except ValidationError:
            return Resumed(None, None, _fault("the order cannot be read", "Arm the line."))
        except VaoiError as error:
            return Resumed(None, None, _fault(error.message, f"{error.action} Then arm the line.".strip()))
        if armed.runs == 0:
            return None
        return Resumed(replace(order, despite_lost_cameras=armed.allow_lost_cameras), armed.runs)


class Rearming:
    """When the station tries again to arm the line by itself, and why it could not so far. Used by one thread."""

    def __init__(self, clock: Callable[[], float] = time.monotonic) -> None:
        self._pace = Backoff(PACE, clock)
        self.why: Reason | None = None
        """Why the line is not armed again after a restart or a fault; None if it was not armed before, or was armed or
        disarmed since."""

    @property
    def is_due(self) -> bool:
        """Whether the next attempt may begin."""
        return self._pace.remaining_s() == 0

    def wait(self, why: str, action: str) -> None:
        """Record what must end before the next attempt."""
        message = f"The line was armed before and could not be armed again: {why}"
        self.why = Reason(code=CODE, message=message, action=f"{action} The station tries again by itself.".strip())

    def fail(self, why: str, action: str) -> None:
        """Record that an attempt failed. The next one is due after a pause."""
        self.wait(why, action)
        self._pace.record_failure()

    def succeed(self) -> bool:
        """Record that the line is armed. Return whether something was against it before."""
        self._pace.reset()
        before, self.why = self.why, None
        return before is not None


def _fault(why: str, action: str) -> Reason:
    message = f"The line was armed before the restart and is not armed now: {why}"
    return Reason(code=CODE, message=message, action=action)
