"""Pins of a held station."""

from __future__ import annotations

from typing import Any, Protocol

from vaoi_station.errors import NotFoundError


class Runs(Protocol):
    """A station that knows its runs."""

    def run(self, run: str) -> Any: ...


class HeldPins:
    """The pins of a held station; it keeps no recordings."""

    def __init__(self, station: Runs) -> None:
        self._station = station
        self._pins: set[str] = set()

    def pin(self, run: str) -> None:
        self._station.run(run)
        self._pins.add(run)

    def unpin(self, run: str) -> None:
        if run not in self._pins:
            raise NotFoundError(f"Run {run!r} is not pinned.", code="not-pinned")
        self._pins.discard(run)

    def shown(self, document: Any) -> Any:
        return document.model_copy(update={"pinned": document.id in self._pins})

    def all_shown(self, documents: tuple[Any, ...]) -> tuple[Any, ...]:
        return tuple(self.shown(document) for document in documents)
