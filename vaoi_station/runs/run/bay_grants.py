"""Grants of bays: the pixels of a bay are set to zero in a thread of its own, before the acquisition process gets it.

The coordinator raises the bay's generation, by which readers of the run before notice that its pixels are gone, and
goes on. Its commands reach the acquisition process in their order: those after a grant wait until the bay is black.

A bay is not blackened before it is granted, although it may be free for long: a camera that was late may still write to
a slot of a run that is over. Such a slot is not used for the run to which the bay is granted (`SlotQueue`).
"""

from __future__ import annotations

import threading
from collections import deque
from typing import Protocol

from vaoi_station.acquisition.process import messages
from vaoi_station.supervised_thread import SupervisedThread


class Blackening(Protocol):
    """The one method of the ring that `BayGrants` calls."""

    def blacken(self, bay: int) -> None:
        """Set all pixels of a bay to zero."""


_CHECK_S = 1.0
"""Longest time between two signs of life of the thread while there is nothing to do."""


class Commands(Protocol):
    """The one method of the link to the acquisition process that `BayGrants` calls."""

    def send(self, command: messages.Command) -> None:
        """Send a command to the acquisition process, without waiting for its effect."""


class BayGrants:
    """Passes commands to the acquisition process, and blackens each bay before its grant. Usable from any thread."""

    def __init__(self, ring: Blackening, link: Commands) -> None:
        self._ring, self._link = ring, link
        self._changed = threading.Condition()
        self._waiting: deque[messages.Command] = deque()
        """Commands in their order. The first stays here until it was sent."""
        self._ended = False
        self.thread = SupervisedThread(self._run, "bays")

    def start(self) -> None:
        """Start the thread."""
        self.thread.start()

    def send(self, command: messages.Command) -> None:
        """Send a command, behind those before it. Returns at once."""
        with self._changed:
            if self._waiting or _bay(command) is not None:
                self._waiting.append(command)
                self._changed.notify_all()
            else:
                self._link.send(command)

    def forget(self) -> None:
        """Give up the commands that were not sent yet: the acquisition process for which they were meant has ended."""
        with self._changed:
            self._waiting.clear()

    def stop(self) -> None:
        """End the thread; what was not sent is given up. A second call does nothing."""
        with self._changed:
            self._ended = True
            self._waiting.clear()
            self.thread.expect_end()
            self._changed.notify_all()
        if self.thread.is_alive():
            self.thread.join()

    def _run(self) -> None:
        while (command := self._next()) is not None:
            if (bay := _bay(command)) is not None:
                self._ring.blacken(bay)
            with self._changed:
                # It was given up meanwhile if it is not the first one any more.
                if self._waiting and self._waiting[0] is command:
                    self._link.send(self._waiting.popleft())

    def _next(self) -> messages.Command | None:
        """Wait for a command and return it; None if the thread is to end."""
        with self._changed:
            while not self._waiting and not self._ended:
                self.thread.beat()
                self._changed.wait(_CHECK_S)
            self.thread.beat()
            return self._waiting[0] if self._waiting and not self._ended else None


def _bay(command: messages.Command) -> int | None:
    """Return the bay that a command grants; None if it grants none."""
    if isinstance(command, messages.FireTrial):
        return command.grant.bay
    return command.bay if isinstance(command, messages.Grant) else None
