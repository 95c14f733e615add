"""Whoever feeds the line: one board after another, each when the station takes boards."""

from __future__ import annotations

import threading
import time
from collections.abc import Callable, Sequence

from vaoi_station.errors import DeviceError
from vaoi_station.rig.line.films import Film
from vaoi_station.rig.line.stage import Passing, Stage

PATIENCE_S = 30.0
"""A station that takes no boards for so long is given one all the same."""
AFTER_S = 1.0
"""From the last pulse of a passage to its end."""


class Conveyor:
    """A thread of its own; a context manager that waits for the last board.

    At its end it raises the DeviceError for which no more boards could pass.
    """

    def __init__(
        self, stage: Stage, films: Sequence[Film], interval_s: float, taken: Callable[[float], bool] = lambda _: True
    ) -> None:
        """`taken` waits so long at most until the station takes boards."""
        self._stage, self._films, self._interval_s, self._taken = stage, films, interval_s, taken
        self._closing = threading.Event()
        self._thread = threading.Thread(target=self._work, name="conveyor")
        self.passed: list[Passing] = []
        self.empty = threading.Event()
        """All boards have passed, or no more can."""
        self._failure: DeviceError | None = None

    def __enter__(self) -> Conveyor:
        self._thread.start()
        return self

    def __exit__(self, kind: type[BaseException] | None, *_: object) -> None:
        self._closing.set()
        self._thread.join()
        if self._failure is not None and kind is None:
            raise self._failure

    def _work(self) -> None:
        try:
            self._feed()
        except DeviceError as error:  # told by whoever waits for us
            self._failure = error
        self.empty.set()

    def _feed(self) -> None:
        due_s = time.monotonic()
        for film in self._films:
            if self._closing.wait(max(due_s - time.monotonic(), 0.0)):
                return
            self._taken(PATIENCE_S)
            due_s = time.monotonic() + self._interval_s
            self.passed.append(self._stage.let_pass(film))
            if self._closing.wait(film.lasts_s + AFTER_S):
                return
