"""Whoever feeds the line: one board after another, each when the station takes boards."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

from vaoi_station.rig.films import Film
from vaoi_station.rig.stage import Passing, Stage

PATIENCE_S = 30.0
"""A station that takes no boards for so long is given one all the same."""
AFTER_S = 1.0
"""From the last pulse of a passage to its end."""


class Conveyor:
    """A thread of its own; a context manager that waits for the last board."""

    def __init__(
        self, stage: Stage, films: Sequence[Film], interval_s: float, taken: Callable[[float], bool] = lambda _: True
    ) -> None:
        """`taken` waits so long at most until the station takes boards."""
        self._stage, self._films, self._interval_s, self._taken = stage, films, interval_s, taken
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._work, name="conveyor")
        self.passed: list[Passing] = []
        self.empty = threading.Event()
        """All boards have passed."""

    def __enter__(self) -> Conveyor:
        self._thread.start()
        return self

    def __exit__(self, *_: object) -> None:
        self._closing.set()
        self._thread.join()

    def _work(self) -> None:
        due_s = time.monotonic()
        for film in self._films:
            if self._closing.wait(max(due_s - time.monotonic(), 0.0)):
                return
            self._taken(PATIENCE_S)
            due_s = time.monotonic() + self._interval_s
            self.passed.append(self._stage.let_pass(film))
            if self._closing.wait(film.lasts_s + AFTER_S):
                return
        self.empty.set()
