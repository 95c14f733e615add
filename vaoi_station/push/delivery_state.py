"""What one receiver got, what failed, and what was given up: one file per receiver, for the next start."""

from __future__ import annotations

import logging
from collections.abc import Callable
from pathlib import Path
from typing import Annotated

from pydantic import BaseModel, ConfigDict, Field

from vaoi_station.errors import VaoiError
from vaoi_station.files.documents import check_format, parse, read_json, write_json
from vaoi_station.runs.states.schemas import EventRecord

_log = logging.getLogger(__name__)
FORMAT, VERSION = "vaoi-push-state", 1
MOST_LETTERS = 200
"""Number of dead letters that are kept for each receiver; beyond it the oldest is dropped."""
Count = Annotated[int, Field(ge=0)]


class DeadLetter(BaseModel):
    """An event that was given up: all attempts to deliver it failed."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    event: EventRecord
    given_up: str
    attempts: Count
    fault: str
    """Why the last attempt failed."""


class DeliveryState(BaseModel):
    """The state of one receiver. It is replaced as a whole, so that any thread may read it."""

    model_config = ConfigDict(frozen=True, extra="forbid")

    format: str = FORMAT
    version: int = VERSION
    last: Count
    """Number of the last event that was delivered, given up, or not wanted."""
    delivered: Count = 0
    failures: Count = 0
    """Attempts that failed."""
    skipped: Count = 0
    """Events that were not sent because too many waited, or that the log had deleted."""
    attempts: Count = 0
    """Attempts that failed for the event whose turn it is."""
    in_a_row: Count = 0
    """Attempts that failed since the last one that succeeded."""
    failing_s: Annotated[float, Field(ge=0)] = 0.0
    """Time since the first failure after the last delivery, without the times when the station was off, s."""
    due_s: float = 0.0
    """Time of the next attempt, s since 1970."""
    fault: str = ""
    """Why the last attempt failed; empty if it succeeded."""
    disabled: str = ""
    """Why nothing is sent any more until an administrator enables it; empty if it is enabled."""
    last_success: str | None = None
    letters: tuple[DeadLetter, ...] = ()
    letters_dropped: Count = 0

    def succeeded(self, number: int | None, when: str) -> DeliveryState:
        """Return the state after the delivery of an event, or, with None, after a connection was made."""
        done = {} if number is None else {"last": number, "delivered": self.delivered + 1, "last_success": when}
        return self.model_copy(
            update={**done, "attempts": 0, "in_a_row": 0, "failing_s": 0.0, "due_s": 0.0, "fault": ""}
        )

    def failed(self, fault: str, failing_s: float, due_s: float) -> DeliveryState:
        """Return the state after an attempt that failed."""
        return self.model_copy(
            update={
                "failures": self.failures + 1, "attempts": self.attempts + 1, "in_a_row": self.in_a_row + 1,
                "failing_s": failing_s, "due_s": due_s, "fault": fault,
            }
        )  # fmt: skip

    def enabled(self) -> DeliveryState:
        """Return the state in which the next attempt is due at once, as after no failure."""
        return self.model_copy(
            update={"disabled": "", "attempts": 0, "in_a_row": 0, "failing_s": 0.0, "due_s": 0.0, "fault": ""}
        )

    def given_up(self, letter: DeadLetter) -> DeliveryState:
        """Return the state after an event became a dead letter; the next event is due at once."""
        letters = (*self.letters, letter)
        dropped = max(0, len(letters) - MOST_LETTERS)
        return self.model_copy(
            update={
                "last": letter.event.number, "attempts": 0, "due_s": 0.0,
                "letters": letters[dropped:], "letters_dropped": self.letters_dropped + dropped,
            }
        )  # fmt: skip

    def without_letter(self, number: int) -> DeliveryState:
        """Return the state without the dead letter of an event."""
        rest = tuple(letter for letter in self.letters if letter.event.number != number)
        return self.model_copy(update={"letters": rest})


def read_state(path: Path, newest: Callable[[], int]) -> DeliveryState:
    """Read the state of a receiver. A new one, or one whose file is damaged, begins with the next event."""
    if path.exists():
        try:
            data = read_json(path)
            check_format(data, path, FORMAT, VERSION)
            state = parse(DeliveryState, data, path)
        except VaoiError as error:
            _log.error("%s Deliveries continue with the next event.", error)
        else:
            last = newest()
            if state.last <= last:
                return state
            # After a restored backup the log is shorter: its next events have numbers that were used before, and what
            # was tried of the event whose turn it was does not count for another one.
            return state.model_copy(update={"last": last, "attempts": 0, "due_s": 0.0})
    return DeliveryState(last=newest())


def write_state(path: Path, state: DeliveryState) -> None:
    """Write the state of a receiver."""
    write_json(path, state.model_dump(mode="json"))


def delete_state(path: Path) -> None:
    """Delete the state of a receiver. A file that cannot be deleted is logged: a new receiver does not read it."""
    try:
        path.unlink(missing_ok=True)
    except OSError as error:
        _log.warning("%s: cannot be deleted (%s).", path, error.strerror)
