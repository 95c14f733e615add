"""Pins of a held station, and databases that were set aside."""

from __future__ import annotations

from typing import Any, Protocol

from vaoi_station.errors import NotFoundError
from vaoi_station.runs.states.storage_schemas import SetAsideFile


class Runs(Protocol):
    """A station that knows its runs."""

    def run(self, run: str) -> Any: ...

    def publish(self, kind: str, message: str = "", **fields: Any) -> None: ...


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


class HeldStorage:
    """Files of a held station that were set aside, by name: whether each is acknowledged."""

    def __init__(self, station: Runs) -> None:
        self._station = station
        self.files: dict[str, bool] = {}

    def set_aside(self) -> tuple[SetAsideFile, ...]:
        found = self.files.items()
        return tuple(SetAsideFile(file=name, code="database-damaged", acknowledged=known) for name, known in found)

    def acknowledge(self, file: str) -> None:
        if file not in self.files:
            raise NotFoundError(f"{file!r} is no database that was set aside.", code="not-set-aside")
        self.files[file] = True
        self._station.publish("storage", code="acknowledged")
