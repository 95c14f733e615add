"""Threads whose end or hang must be noticed: each records that it is alive, and a supervisor reads these records."""

from __future__ import annotations

import logging
import math
import os
import threading
import time
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager, suppress
from typing import NamedTuple

_log = logging.getLogger(__name__)

LIMIT_S = 15.0
"""Longest time between two heartbeats of a thread, unless its owner sets another limit."""

DEVICE_LIMIT_S = 30.0
"""Longest time between two heartbeats of a thread that serves a device: some of its requests take seconds."""


URGENT_NICE = -10
"""Niceness of urgent threads."""


class ThreadFault(NamedTuple):
    """A thread that has ended without a request, or that hangs."""

    thread: str
    what: str
    """The fault, worded as the end of a sentence."""

    def __str__(self) -> str:
        return f"Thread {self.thread!r} {self.what}."


class SupervisedThread(threading.Thread):
    """A daemon thread that serves until its owner calls `expect_end`. Any other end, and a hang, is a fault.

    The thread calls `beat` in every pass of its loop, and `rest` before it waits for work without a limit of time.
    """

    def __init__(
        self, target: Callable[[], object], name: str, limit_s: float = LIMIT_S, *, urgent: bool = False
    ) -> None:
        """Prepare a thread; `limit_s` is the longest time between two heartbeats.

        An `urgent` one computes little, and another machine waits for it: it goes before the workers, if the system
        allows it.
        """
        super().__init__(name=name, daemon=True)
        self._work, self._limit_s, self._urgent = target, limit_s, urgent
        self._beat_s = math.inf
        self._failure = ""
        self._end_expected = False

    def beat(self) -> None:
        """Record that the thread is alive now."""
        self._beat_s = time.monotonic()

    def rest(self) -> None:
        """Record that the thread waits for work: until the next heartbeat its silence is no fault."""
        self._beat_s = math.inf

    @contextmanager
    def waiting(self) -> Iterator[None]:
        """Record that the thread waits for work while a `with` block runs, and that it is alive after it."""
        self.rest()
        try:
            yield
        finally:
            self.beat()

    @contextmanager
    def serving(
        self, watch: Callable[[SupervisedThread], object], end: Callable[[], object], limit_s: float
    ) -> Iterator[None]:
        """Run during a `with` block: `watch` supervises the thread, `end` asks it to end, for `limit_s` at most."""
        self.start()
        watch(self)
        try:
            yield
        finally:
            self.expect_end()
            end()
            self.join(limit_s)

    def expect_end(self) -> None:
        """Record that the thread was asked to end, so that its end is not a fault."""
        self._end_expected = True

    @property
    def has_ended(self) -> bool:
        """Whether the thread was asked to end, and did."""
        return self._end_expected and self.ident is not None and not self.is_alive()

    def run(self) -> None:
        """Call the target. An exception that it raises is logged and becomes a fault."""
        self.beat()
        if self._urgent:
            with suppress(OSError):  # LimitNICE of the unit allows it; a station started by hand goes without
                os.setpriority(os.PRIO_PROCESS, threading.get_native_id(), URGENT_NICE)
        try:
            self._work()
        except BaseException as error:  # noqa: BLE001  any end of the thread is a fault, which the supervisor acts on
            self._failure = f"{type(error).__name__}: {error}".rstrip(": ")
            _log.critical("thread %s has ended", self.name, exc_info=True)
        finally:
            # The work is often a method of the thread's owner: the two would keep each other, and what the owner holds.
            del self._work

    def fault(self) -> ThreadFault | None:
        """Return the fault of the thread; None if there is none, or if the thread was not started yet."""
        if self.ident is None or self._end_expected:
            return None
        if self._failure:
            return ThreadFault(self.name, f"has ended ({self._failure})")
        if not self.is_alive():
            return ThreadFault(self.name, "has ended without an error")
        silence_s = time.monotonic() - self._beat_s
        return ThreadFault(self.name, f"hangs for {silence_s:.0f} s") if silence_s > self._limit_s else None


def faults_of(threads: Sequence[SupervisedThread]) -> tuple[ThreadFault, ...]:
    """Return the faults of all threads that have one."""
    return tuple(fault for thread in threads if (fault := thread.fault()) is not None)
