"""The inbox of the acquisition process: messages of all threads, and the time up to which all of them were taken.

A process may be held up for a second, by another program or by a disk. Then a frame that arrived in time still lies in
the inbox when its deadline has passed. So deadlines are compared with the time of the inbox, not with the clock.
"""

from __future__ import annotations

import queue
from time import monotonic
from typing import Any

HELD_UP_S = 0.1
"""A wait that ends later than this, or a message that takes longer, shows that the process was held up.

Threads of devices were probably held up as well, so this is also the time that they are given to deliver."""
LONGEST_LAG_S = 2.0
"""Largest lag of the inbox's time behind the clock.

It bounds the delay if messages come without a pause."""


class Inbox:
    """A queue of messages of several threads, which one thread takes."""

    def __init__(self) -> None:
        self.messages: queue.SimpleQueue[Any] = queue.SimpleQueue()
        """The queue into which threads put their messages."""
        self.taken_until_s = self._returned_s = monotonic()
        """Time up to which all messages were taken, by time.monotonic()."""
        self._held_up = False

    def take(self, until_s: float) -> Any:
        """Wait for a message until the given time of time.monotonic(), and return it; None if none came.

        If the process was held up, the wait lasts at least `HELD_UP_S`.
        """
        now_s = monotonic()
        if self._held_up or now_s > self._returned_s + HELD_UP_S:
            until_s = max(until_s, now_s + HELD_UP_S)
        until_s = max(until_s, now_s)
        try:
            message = self.messages.get(timeout=until_s - now_s)
        except queue.Empty:
            message = None
        self._returned_s = monotonic()
        self._held_up = self._returned_s > until_s + HELD_UP_S
        # The time was read first: a message that comes between the two lines was put after it.
        if self.messages.empty() and not self._held_up:
            self.taken_until_s = self._returned_s
        self.taken_until_s = max(self.taken_until_s, self._returned_s - LONGEST_LAG_S)
        return message
