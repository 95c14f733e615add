"""Search in the summaries of runs: by verdict, board type, board id, reason and time.

A request reads at most `MOST_SCANNED` summaries, however many there are, so that a search of a year's runs does not
occupy a connection to the database for long. The caller goes on from where it ended.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass
from typing import Any

from vaoi_station.store.database import Database
from vaoi_station.store.schema import ANY_OF, keys_of

MOST_SCANNED = 20_000
"""Largest number of summaries that one request reads; some 0.2 s, without the lock of the interpreter."""
NO_VERDICT = "none"
"""In place of a verdict: the run ended without a result."""
_FIELD = "CASE WHEN json_valid(summary) THEN json_extract(summary, '$.{}') END"
_VERDICT = f"coalesce({_FIELD.format('verdict')}, '{NO_VERDICT}')"
"""SQL expression: the verdict of a run that has ended."""
_REASONS = "json_each(CASE WHEN json_valid(summary) THEN summary END, '$.reasons')"


@dataclass(frozen=True)
class RunFilter:
    """What is asked of a run; None asks for nothing."""

    verdict: str | None = None
    """ok, degraded, failed, or `NO_VERDICT`."""
    board_type: str | None = None
    board_id: str | None = None
    reason: str | None = None
    """Code of a reason, or its cause."""
    since: str | None = None
    """Only boards that came at this time or later; RFC 3339 in UTC with milliseconds, so that texts sort by time."""
    until: str | None = None
    """Only boards that came before this time."""

    def admits(
        self, verdict: str | None, board_type: str, board_id: str | None, codes: Sequence[str], started: str
    ) -> bool:
        """Return whether a run is wanted: its verdict (`NO_VERDICT` without one, None if it has not ended) and so on.

        `codes` are the codes and causes of its reasons.
        """
        return (
            self.verdict in (None, verdict)
            and self.board_type in (None, board_type)
            and self.board_id in (None, board_id)
            and (self.reason is None or self.reason in codes)
            and (self.since is None or started >= self.since)
            and (self.until is None or started < self.until)
        )

    def condition(self) -> tuple[str, tuple[Any, ...]]:
        """Return the same as a condition in SQL on runs, with the values of its parameters."""
        codes = f"SELECT json_extract(value, '$.code') FROM {_REASONS}"
        conditions = {
            f"finish_number IS NOT NULL AND {_VERDICT} = ?": self.verdict,
            f"{_FIELD.format('board_type')} = ?": self.board_type,
            f"{_FIELD.format('board_id')} = ?": self.board_id,
            f"? IN ({codes} UNION ALL {codes.replace('.code', '.cause')})": self.reason,
            f"{_FIELD.format('started')} >= ?": self.since,
            f"{_FIELD.format('started')} < ?": self.until,
        }
        given = {text: value for text, value in conditions.items() if value is not None}
        return " AND ".join(given) or "1", tuple(given.values())


@dataclass(frozen=True)
class Found:
    """The ids of the runs that were found, newest first, and where the search goes on."""

    runs: tuple[str, ...]
    before: str | None
    """The oldest run that was read, if there may be more: the search goes on with the runs below it."""


@dataclass(frozen=True)
class Verdicts:
    """Numbers of runs by verdict."""

    runs: dict[str, int]
    complete: bool
    """Whether all runs were counted; False: the newest `MOST_SCANNED`."""


class RunSearch:
    """Searches the runs of one station."""

    def __init__(self, database: Database) -> None:
        self._database = database

    def find(
        self, wanted: RunFilter, limit: int, before: str | None, oldest: str = "", without: Sequence[str] = ()
    ) -> Found:
        """Return the ids of at most `limit` wanted runs below the id `before` and from `oldest` on, without some."""
        condition, values = wanted.condition()
        # SQLite makes the rows of the inner query one by one: the search ends as soon as it has found enough.
        runs = self._database.column(
            f"""SELECT id FROM (SELECT id, summary, finish_number FROM runs
                WHERE (?1 IS NULL OR id < ?1) AND id >= ?2 ORDER BY id DESC LIMIT {MOST_SCANNED})
                WHERE id NOT {ANY_OF.replace("?", "?3")} AND {condition} ORDER BY id DESC LIMIT ?""",
            (before, oldest, keys_of(without), *values, limit),
        )
        if len(runs) == limit:
            return Found(tuple(runs), runs[-1])
        last: str | None = self._database.value(
            f"""SELECT id FROM runs WHERE (?1 IS NULL OR id < ?1) AND id >= ?2
                ORDER BY id DESC LIMIT 1 OFFSET {MOST_SCANNED - 1}""",
            (before, oldest),
        )
        return Found(tuple(runs), last)

    def verdicts(self, since: str, oldest: str, without: Sequence[str] = ()) -> Verdicts:
        """Return how many runs ended since a time, by verdict; `oldest` and `without` as in `find`."""
        condition, values = RunFilter(since=since).condition()
        rows = self._database.read(
            f"""SELECT {_VERDICT} AS verdict, count(*) AS runs
                FROM (SELECT id, summary, finish_number FROM runs WHERE id >= ? ORDER BY id DESC LIMIT {MOST_SCANNED})
                WHERE finish_number > 0 AND id NOT {ANY_OF}
                AND {condition} GROUP BY 1""",
            (oldest, keys_of(without), *values),
        )
        more = self._database.read(
            f"""SELECT 1 FROM (SELECT summary FROM runs WHERE id >= ? ORDER BY id DESC LIMIT 1 OFFSET {MOST_SCANNED})
                WHERE {condition}""",
            (oldest, *values),
        )
        return Verdicts({str(row["verdict"]): int(row["runs"]) for row in rows}, not more)

    def count_events(self, kind: str, since: str) -> int:
        """Return the number of events of a kind since a time, of those that are kept."""
        query = """SELECT count(*) FROM events WHERE instr(document, ?) AND json_valid(document)
                   AND json_extract(document, '$.kind') = ? AND json_extract(document, '$.time') >= ?"""
        return int(self._database.value(query, (f'"{kind}"', kind, since)))

    def oldest_since(self, id_bound: str) -> str:
        """Return the id from which runs are read that came since a time; `id_bound` sorts before all ids of that time.

        An id is given when memory is granted, long before the board comes: one run may have an earlier id.
        """
        return str(self._database.value("SELECT max(id) FROM runs WHERE id < ?", (id_bound,)) or "")
