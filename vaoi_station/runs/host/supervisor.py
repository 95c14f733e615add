"""Supervision of the station's threads. While one of them has ended or hangs, systemd's watchdog is not reset.

The supervisor is a thread too: if it ends or hangs, the watchdog is not reset either.
"""

from __future__ import annotations

import threading
from collections.abc import Callable, Sequence

from vaoi_station.supervised_thread import SupervisedThread, ThreadFault, faults_of

PERIOD_S = 0.5
"""Time between two checks of the threads, s."""


class Supervisor:
    """Checks threads twice a second. It reports each thread that has ended or hangs, once."""

    def __init__(self, alive: Callable[[], object], on_faults: Callable[[Sequence[ThreadFault]], object]) -> None:
        """Begin without threads.

        Args:
            alive: called after every check in which all threads were alive, to reset a watchdog.
            on_faults: called with new faults.
        """
        self._alive, self._on_faults = alive, on_faults
        self._watched: tuple[SupervisedThread, ...] = ()
        self._reported: set[str] = set()
        self._stopping = threading.Event()
        self.thread = SupervisedThread(self._run, "supervisor")

    def watch(self, *threads: SupervisedThread) -> None:
        """Add threads to those that are checked; those that have ended as they were asked to are checked no more."""
        self._watched = (*(thread for thread in self._watched if not thread.has_ended), *threads)

    def faults(self) -> tuple[ThreadFault, ...]:
        """Return one fault for each thread that has ended or hangs now. Call it from any thread."""
        return faults_of((*self._watched, self.thread))

    def start(self) -> None:
        """Start to check the threads."""
        self.thread.start()

    def stop(self) -> None:
        """Stop checking the threads."""
        self.thread.expect_end()
        self._stopping.set()
        if self.thread.ident is not None and threading.current_thread() is not self.thread:
            self.thread.join()

    def _run(self) -> None:
        while not self._stopping.wait(PERIOD_S):
            self.thread.beat()
            faults = faults_of(self._watched)
            if not faults:
                self._alive()
            new = [fault for fault in faults if fault.thread not in self._reported]
            self._reported = {fault.thread for fault in faults}
            if new:
                self._on_faults(new)
