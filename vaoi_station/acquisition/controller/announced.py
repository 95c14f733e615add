"""What the contacts of the machine upstream have announced of the boards that have not met the barrier yet."""

from __future__ import annotations

import math
from typing import Literal

from vaoi_station.acquisition.controller.interface import (
    BarrierBlocked,
    BoardTooSoon,
    Contacts,
    ContactsChanged,
    ControllerEvent,
)

Came = Literal["announced", "failed", "by-hand"]
"""How the line announced a board: as available, as failed, or not at all, so that somebody put it in by hand."""
_LOSING = frozenset({"events-lost", "controller-reset"})
APART_S = 0.05
"""Shortest opening between two boards by IPC-SMEMA-9851; a shorter one belongs to one board."""


class AnnouncedBoards:
    """Counts the announced boards. Times are those of the controller's clock, at which the changes are in order.

    While several boards are on their way one of which is failed, each of them counts as failed, and so does one that
    nothing announces behind a failed one: a bad board never passes as a good one.
    """

    def __init__(self, longest_s: float, *, wired: bool = True) -> None:
        """Begin while boards may be on their way.

        `longest_s`: a board has met the barrier this long after its contact opened. `wired` is whether contacts will
        be reported: until then, each board counts as failed.
        """
        self._longest_s, self._wired = longest_s, wired
        self._contacts: Contacts | None = None
        self._opened_s = -math.inf
        self._waiting = 0
        self._failed_until_s = -math.inf
        """Time until which a failed board may come; infinite while its contact is closed."""
        self._swapped = False
        """Whether the latest board counted as failed: a board that nothing announces may be the one that is meant."""
        self._lost = True
        self._lost_until_s = -math.inf
        """Time until which a board may come whose announcement was lost."""
        self._came: Came | None = None
        """How the board was announced whose edge was reported last, until its run begins."""
        self._now_s = -math.inf

    def follow(self, event: ControllerEvent) -> None:
        """Take an event of the controller: a change of contacts, or a board that meets the barrier."""
        self._now_s = event.time_s
        if isinstance(event, ContactsChanged):
            self._change(event.contacts, event.time_s)
        elif isinstance(event, BarrierBlocked):
            self._came = self._arrive(event.time_s)
        elif isinstance(event, BoardTooSoon):
            self._arrive(event.time_s)

    def take_came(self) -> Came | None:
        """Return how the board was announced whose run begins, once, also if the report of its edge was lost."""
        came, self._came = self._came, None
        return came or self._arrive(self._now_s)

    def lose(self, code: str) -> None:
        """Take a fault of the controller by its code. If changes were lost, the next boards count as failed ones."""
        if self._wired and code in _LOSING:
            self._lost, self._came = True, None

    def _change(self, contacts: Contacts, time_s: float) -> None:
        self._forget(time_s)
        before, self._contacts = _closed(self._contacts), contacts
        if _closed(contacts) and not before:
            if time_s - self._opened_s >= APART_S or not self._waiting:
                self._waiting, self._swapped = self._waiting + 1, False
        elif before and not _closed(contacts):
            self._opened_s = time_s
            if math.isinf(self._failed_until_s) and self._failed_until_s > 0:
                self._failed_until_s = time_s + self._longest_s
        if contacts.failed and self._waiting:
            self._failed_until_s = math.inf

    def _arrive(self, time_s: float) -> Came | None:
        """Take that a board meets the barrier; return how it was announced, None without contacts."""
        if self._contacts is None:
            return "failed" if self._wired else None
        self._forget(time_s)
        lost = time_s < self._lost_until_s
        if not self._waiting and not _closed(self._contacts):
            return "failed" if self._swapped or lost else "by-hand"
        failed = self._contacts.failed or time_s < self._failed_until_s or lost
        self._waiting = max(self._waiting - 1, 0)
        if not self._waiting:
            self._failed_until_s, self._swapped = -math.inf, failed
        return "failed" if failed else "announced"

    def _forget(self, time_s: float) -> None:
        """Forget boards that would have come by now."""
        if not _closed(self._contacts) and time_s - self._opened_s > self._longest_s:
            self._waiting, self._swapped = 0, False
        if self._lost:
            self._lost, self._lost_until_s = False, time_s + self._longest_s


def _closed(contacts: Contacts | None) -> bool:
    return contacts is not None and (contacts.available or contacts.failed)
