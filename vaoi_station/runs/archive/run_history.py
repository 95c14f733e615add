"""What callers ask of the history: runs that match a filter, counts since a time, and decisions of persons."""

from __future__ import annotations

from collections.abc import Callable
from datetime import UTC, datetime
from typing import Literal

from pydantic import ValidationError

from vaoi_station.errors import DeviceError, StateError
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.states.decision_schemas import Choice, Decision, RunCounts
from vaoi_station.runs.states.run_ids import earliest_id, utc
from vaoi_station.runs.states.schemas import RunSummary
from vaoi_station.runs.states.tables import RunState
from vaoi_station.store.history.run_search import NO_VERDICT, RunFilter

Wanted = Literal["ok", "degraded", "failed", "none"]
"""A verdict, or `none`: the run ended without a result."""
_CHOICES: dict[Choice, str] = {"film-again": "The board is to be filmed again", "use": "Its pictures are used"}


class RunHistory:
    """Searches, counts and decides. Its methods may be called from any thread."""

    def __init__(
        self,
        archive: Archive,
        events: EventLog,
        shown: Callable[[tuple[RunSummary, ...]], tuple[RunSummary, ...]],
    ) -> None:
        """Store the parts. `shown` returns summaries with the verdicts that their identities leave them."""
        self._archive, self._events, self._shown = archive, events, shown

    def find(self, wanted: RunFilter, limit: int, before: str | None) -> tuple[list[RunSummary], str | None]:
        """Return at most `limit` runs that a filter admits, newest first, and where the search goes on (None: nowhere).

        One call reads a bounded number of runs, so it may find fewer than `limit` although there are more.
        """
        oldest = self._oldest(wanted.since)
        # Runs that the disk has not taken yet are in memory; the database has them as they began. They are read first:
        # one that is written meanwhile is in at least one of the two.
        waiting = self._shown(self._archive.unstored())
        found = self._archive.search.find(wanted, limit, before, oldest, [run.id for run in waiting])
        runs = self._archive.summaries(found.runs)
        for summary in waiting:
            here = (before is None or summary.id < before) and (found.before is None or summary.id >= found.before)
            if here and self.admits(wanted, summary):
                runs[summary.id] = summary
        chosen = sorted(runs, reverse=True)[:limit]
        more = chosen[-1] if len(chosen) == limit else found.before
        return [runs[run] for run in chosen], more

    def counts(self, since: datetime) -> RunCounts:
        """Return how many boards have passed since a time, by verdict, and how many were missed."""
        moment = utc(since.astimezone(UTC))
        waiting = self._shown(self._archive.unstored())
        found = self._archive.search.verdicts(moment, self._oldest(moment), [run.id for run in waiting])
        stored = dict(found.runs)
        for summary in (s for s in waiting if s.started >= moment):
            verdict = summary.verdict or NO_VERDICT
            stored[verdict] = stored.get(verdict, 0) + 1
        return RunCounts(
            since=moment,
            ok=stored.get("ok", 0),
            degraded=stored.get("degraded", 0),
            failed=stored.get("failed", 0) + stored.get(NO_VERDICT, 0),
            missed=self._archive.search.count_events("board-missed", moment),
            complete=found.complete,
        )

    def decide(self, run: str, choice: Choice, name: str, reason: str) -> None:
        """Keep what a person has decided about a run; a later decision replaces it.

        Raises:
            NotFoundError: the run is unknown.
            StateError: the run has not ended, or is not on disk yet.
        """
        self._archive.get(run)
        decision = Decision(choice=choice, name=name, reason=reason, decided=utc())
        if not self._archive.decisions.save(run, decision.model_dump_json()):
            raise StateError(
                f"Run {run} is not on disk yet, so that no decision about it can be kept.",
                action="Repeat this once the data disk takes writes again.",
                code="not-stored",
            )
        self._events.add("decision", f"{_CHOICES[choice]}, decided by {name}: {reason}", run=run, state=choice)

    def decisions(self, runs: tuple[RunSummary, ...]) -> dict[str, Decision]:
        """Return the decisions about some runs, by run id."""
        found: dict[str, Decision] = {}
        try:
            documents = self._archive.decisions.documents([run.id for run in runs])
        except DeviceError:
            return {}  # The latest runs are in memory, and shown even if the disk cannot be read.
        for run, document in documents.items():
            try:
                found[run] = Decision.model_validate_json(document)
            except ValidationError:
                continue  # of another version: the run is shown without it
        return found

    def _oldest(self, since: str | None) -> str:
        if since is None:
            return ""
        return self._archive.search.oldest_since(earliest_id(datetime.fromisoformat(since).timestamp()))

    @staticmethod
    def admits(wanted: RunFilter, run: RunSummary) -> bool:
        """Return whether a filter admits a run, as it is shown."""
        codes = [code for reason in run.reasons for code in (reason.code, reason.cause)]
        ended = run.state not in (RunState.FILMING, RunState.STITCHING)
        verdict = run.verdict or (NO_VERDICT if ended else None)
        return wanted.admits(verdict, run.board_type, run.board_id, codes, run.started)
