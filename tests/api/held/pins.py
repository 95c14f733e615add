"""Pins, decisions and search of a held station, and databases that were set aside."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any, Protocol

from vaoi_station.errors import NotFoundError
from vaoi_station.model import Status
from vaoi_station.runs.archive.run_history import RunHistory
from vaoi_station.runs.states.decision_schemas import Choice, Decision, RunCounts
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.storage_schemas import SetAsideFile
from vaoi_station.store.history.run_search import RunFilter


class Runs(Protocol):
    """A station that knows its runs."""

    def run(self, run: str) -> Any: ...

    def runs(self, limit: int = 50, before: str | None = None) -> tuple[Any, ...]: ...

    def publish(self, kind: str, message: str = "", **fields: Any) -> None: ...


class HeldDecisions:
    """Search, counts and decisions over the runs that a held station has filmed."""

    def __init__(self, station: Runs) -> None:
        self._station = station
        self.made: dict[str, Decision] = {}
        self.missed = 0

    def find(self, wanted: RunFilter, limit: int, before: str | None) -> tuple[list[Any], str | None]:
        found = [run for run in self._station.runs(1000, before) if RunHistory.admits(wanted, run)]
        return found[:limit], found[limit - 1].id if len(found) > limit else None

    def counts(self, since: datetime) -> RunCounts:
        verdicts = [run.verdict for run in self._station.runs(1000)]
        ok, degraded, failed = (verdicts.count(v) for v in (Status.OK, Status.DEGRADED, Status.FAILED))
        moment = utc(since.astimezone(UTC))
        return RunCounts(since=moment, ok=ok, degraded=degraded, failed=failed, missed=self.missed)

    def decide(self, run: str, choice: Choice, name: str, reason: str) -> None:
        self._station.run(run)
        self.made[run] = Decision(choice=choice, name=name, reason=reason, decided=utc())
        self._station.publish("decision", f"{name}: {reason}", run=run, state=choice)


class HeldPins:
    """The pins of a held station; it keeps no recordings."""

    def __init__(self, station: Runs) -> None:
        self._station = station
        self._pins: set[str] = set()
        self.history = HeldDecisions(station)

    def pin(self, run: str) -> None:
        self._station.run(run)
        self._pins.add(run)

    def unpin(self, run: str) -> None:
        if run not in self._pins:
            raise NotFoundError(f"Run {run!r} is not pinned.", code="not-pinned")
        self._pins.discard(run)

    def shown(self, document: Any) -> Any:
        decision = self.history.made.get(document.id)
        return document.model_copy(update={"pinned": document.id in self._pins, "decision": decision})

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
