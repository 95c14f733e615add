"""What the contacts of the machine upstream have announced of the boards that have not met the barrier yet."""

from __future__ import annotations

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

    While boards are on their way one of which is failed, each of them counts as failed: a bad board never passes as a
    good one.
    """

    def __init__(self) -> None:
        self._contacts: Contacts | None = None
        self._opened_s = float("-inf")
        self._waiting = 0
        self._failed = False
        self._came: Came | None = None
        """How the board was announced whose edge was reported last, until its run begins."""

    def follow(self, event: ControllerEvent) -> None:
        """Take an event of the controller: a change of contacts, or a board that meets the barrier."""
        if isinstance(event, ContactsChanged):
            self.change(event.contacts, event.time_s)
        elif isinstance(event, BarrierBlocked):
            self._came = self.arrive()
        elif isinstance(event, BoardTooSoon):
            self.arrive()

    def take_came(self) -> Came | None:
        """Return how the board was announced whose run begins, once, also if the report of its edge was lost."""
        came, self._came = self._came, None
        return came or self.arrive()

    def change(self, contacts: Contacts, time_s: float) -> None:
        """Take the contacts from now on."""
        before, self._contacts = _closed(self._contacts), contacts
        if _closed(contacts) and not before:
            if time_s - self._opened_s >= APART_S or not self._waiting:
                self._waiting += 1
            self._failed = contacts.failed or (self._failed and self._waiting > 1)
        elif before and not _closed(contacts):
            self._opened_s = time_s
        self._failed |= contacts.failed and self._waiting > 0

    def lose(self, code: str) -> None:
        """Take a fault of the controller by its code. If changes were lost, the next board counts as a failed one."""
        if self._contacts is not None and code in _LOSING:
            self._waiting, self._failed, self._came = max(self._waiting, 1), True, None

    def forget(self) -> None:
        """Forget announced boards at an arming: they may have passed or been taken off. A failed one may still come."""
        if not self._failed:
            self._waiting = int(_closed(self._contacts))

    def arrive(self) -> Came | None:
        """Take that a board meets the barrier; return how it was announced, None without contacts."""
        if self._contacts is None:
            return None
        if not self._waiting and not _closed(self._contacts):
            return "by-hand"
        failed = self._failed or self._contacts.failed
        self._waiting = max(self._waiting - 1, 0)
        self._failed = self._failed and self._waiting > 0
        return "failed" if failed else "announced"


def _closed(contacts: Contacts | None) -> bool:
    return contacts is not None and (contacts.available or contacts.failed)
