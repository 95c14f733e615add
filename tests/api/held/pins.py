"""Pins, decisions and search of a held station, and databases that were set aside."""

from __future__ import annotations

from datetime import UTC, datetime
from typing import Any

from tests.api.held.trends import HeldTrends
from vaoi_station.errors import NotFoundError, StateError
from vaoi_station.identity.comparison import compare
from vaoi_station.model import BoardCode, BoardIdentity, BoardReading, Status
from vaoi_station.model.board_identity import IdentityDocument, IdentityState, ReportedId
from vaoi_station.runs.archive.storage_watch import StorageFigures
from vaoi_station.runs.kept_runs import RunHistory
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.schemas import Choice, Decision, IdentitySummary, RunCounts, SetAsideFile
from vaoi_station.store.run_search import RunFilter


class HeldDecisions:
    """Search, counts and decisions over the runs that a held station has filmed."""

    def __init__(self, station: Any) -> None:
        self._station = station
        self.made: dict[str, Decision] = {}
        self.missed = 0
        self.most_scanned = 10_000
        """Number of runs that one search looks through."""

    def find(self, wanted: RunFilter, limit: int, before: str | None) -> tuple[list[Any], str | None]:
        scanned = self._station.runs(self.most_scanned, before)
        found = [run for run in scanned if RunHistory.admits(wanted, run)]
        if len(found) > limit:
            return found[:limit], found[limit - 1].id
        return found, scanned[-1].id if len(scanned) == self.most_scanned else None

    def counts(self, since: datetime) -> RunCounts:
        verdicts = [run.verdict for run in self._station.runs(1000)]
        ok, degraded, failed = (verdicts.count(v) for v in (Status.OK, Status.DEGRADED, Status.FAILED))
        moment = utc(since.astimezone(UTC))
        return RunCounts(since=moment, ok=ok, degraded=degraded, failed=failed, missed=self.missed)

    def decide(self, run: str, choice: Choice, name: str, reason: str) -> None:
        self._station.run(run)
        self.made[run] = Decision(choice=choice, name=name, reason=reason, decided=utc())
        self._station.publish("decision", f"{name}: {reason}", run=run, state=choice)


class HeldIdentities:
    """The identities of a held station: readings by run; a run in `pending` is being read."""

    def __init__(self, station: Any) -> None:
        self._station = station
        self.identity = BoardIdentity(pattern="demo;{id}")
        self.readings: dict[str, BoardReading] = {}
        self.pending: set[str] = set()
        self._reported: dict[str, ReportedId] = {}

    def document(self, run: str) -> IdentityDocument:
        armed, read = self._station.run(run).board_id, self.readings.get(run)
        without: IdentityState = "pending" if run in self.pending else "not-read"
        return compare(self.identity, read, armed, self._reported.get(run), without=without)

    def report(self, run: str, reported: ReportedId) -> IdentityDocument:
        if self.document(run).state == "pending":
            raise StateError(f"The codes of run {run} are being read.", code="identity-pending")
        self._reported[run] = reported
        return self.document(run)

    def read(self, run: str, *texts: str) -> None:
        corners = ((0.0, 0.0), (1.0, 0.0), (1.0, 1.0), (0.0, 1.0))
        codes = [
            BoardCode(
                text=text, symbology="qr", board_id=self.identity.board_id(text), center=(0.5, 0.5), corners=corners,
                module_mm=0.2, error_correction_used=0.0,
            )
            for text in texts
        ]  # fmt: skip
        self.readings[run] = BoardReading(codes=tuple(codes))
        self.pending.discard(run)
        self._station.publish("identity", state=self.document(run).state, run=run)


class HeldPins:
    """The pins of a held station; it keeps no recordings."""

    def __init__(self, station: Any) -> None:
        self._station = station
        self.identities = HeldIdentities(station)
        self.mosaics: Any = None
        """The small pictures of whole boards; set by the station."""
        self._pins: set[str] = set()
        self.history, self.trends = HeldDecisions(station), HeldTrends()

    def pin(self, run: str) -> None:
        self._station.run(run)
        self._pins.add(run)

    def unpin(self, run: str) -> None:
        if run not in self._pins:
            raise NotFoundError(f"Run {run!r} is not pinned.", code="not-pinned")
        self._pins.discard(run)

    def with_id(
        self, board_id: str, wanted: RunFilter, limit: int, before: str | None
    ) -> tuple[tuple[Any, ...], str | None]:
        read = [r for r in self.identities.readings if self.identities.document(r).board_id == board_id]
        runs = [r for r in sorted(read, reverse=True) if before is None or r < before]
        found = [run for run in map(self._station.run, runs[:limit]) if RunHistory.admits(wanted, run)]
        return tuple(found), runs[limit - 1] if len(runs) > limit else None

    def shown(self, document: Any, figures: bool = False) -> Any:
        decision = self.history.made.get(document.id)
        known = document.id in {*self.identities.readings, *self.identities.pending}
        identity = IdentitySummary.of(self.identities.document(document.id)) if known else None
        changes: dict[str, Any] = {"pinned": document.id in self._pins, "decision": decision, "identity": identity}
        if figures:
            changes["figures"] = self.trends.figures([document.id]).get(document.id)
        return document.model_copy(update=changes)

    def all_shown(self, documents: tuple[Any, ...], figures: bool = False) -> tuple[Any, ...]:
        return tuple(self.shown(document, figures) for document in documents)


class HeldStorage:
    """Files of a held station that were set aside, by name: whether each is acknowledged."""

    def __init__(self, station: Any) -> None:
        self._station = station
        self.files: dict[str, bool] = {}

    def set_aside(self) -> tuple[SetAsideFile, ...]:
        found = self.files.items()
        return tuple(SetAsideFile(file=name, code="database-damaged", acknowledged=known) for name, known in found)

    def figures(self) -> StorageFigures:
        return StorageFigures(50_000_000_000, 1_000_000, 0, "")

    def acknowledge(self, file: str) -> None:
        if file not in self.files:
            raise NotFoundError(f"{file!r} is no database that was set aside.", code="not-set-aside")
        self.files[file] = True
        self._station.publish("storage", code="acknowledged")
