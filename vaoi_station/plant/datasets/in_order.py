"""Puts what workers finish in any order into the order of the runs."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path


class InOrder:
    """Gives the outcome of each run to `take` when those of all runs before it have come.

    What comes early waits in files: a run that is tried again may keep many others waiting.
    """

    def __init__(self, folder: Path, take: Callable[[bytes], None]) -> None:
        self._folder, self._take = folder, take
        self._next = 0
        self._early: dict[int, Path | bytes | None] = {}

    def put(self, number: int, content: bytes | None) -> None:
        """Receive the outcome of a run by its number; None: the run is left out."""
        self._early[number] = content if number == self._next else self._stored(number, content)
        while self._next in self._early:
            outcome = self._early.pop(self._next)
            self._next += 1
            if isinstance(outcome, Path):
                path, outcome = outcome, outcome.read_bytes()
                path.unlink()
            if outcome is not None:
                self._take(outcome)

    def _stored(self, number: int, content: bytes | None) -> Path | None:
        if content is None:
            return None
        path = self._folder / str(number)
        path.write_bytes(content)
        return path
