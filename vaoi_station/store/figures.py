"""Figures of boards over time: of the newest boards one by one, of all boards per hour, and changes of their causes.

They do not refer to runs, so that they outlive them. Times are RFC 3339 in UTC with milliseconds, which sort as texts.
"""

from __future__ import annotations

import json
import sqlite3
from collections.abc import Callable, Iterator, Mapping, Sequence
from concurrent.futures import Future
from dataclasses import dataclass
from typing import Any, TypeVar

from vaoi_station.store.database import Database
from vaoi_station.store.schema import ANY_OF, keys_of

MOST_BOARDS = 200_000
"""Largest number of boards whose figures are kept one by one; some 46 days at a board every 20 s."""
LEAST_BOARDS = 1000
BYTES_PER_BOARD = 1000
"""Space that the figures of one board take, with their index: 8 cameras and 2 lights have some 40 figures."""
SHARE = 0.05
"""Share of `database_gb` that these figures may take, so that they do not push results out of a small database."""
HOURS_YEARS = 10
"""Time, in years, for which figures per hour are kept."""
MOST_MARKS = 5000
_EVERY = 500
"""Number of boards after which old rows are deleted."""
MOST_HOURS = 20_000
"""Largest number of rows per hour and board type that one request reads."""
_BATCH = 100
"""Number of rows whose documents are in memory at a time: those of 20,000 hours take 340 MB when they are parsed."""

T = TypeVar("T")
HourFigure = tuple[int, float, float, float, str]
"""Number of boards, mean, least and largest value of one figure in an hour, and the run that `merged` chooses."""


@dataclass(frozen=True)
class BoardRow:
    """The figures of one board."""

    run: str
    started: str
    board_type: str
    figures: Mapping[str, float]


@dataclass(frozen=True)
class HourRow:
    """The figures of the boards of one type in one hour; `hour` is the beginning of the time, as "2026-11-23T04"."""

    hour: str
    board_type: str
    figures: Mapping[str, HourFigure]


@dataclass(frozen=True)
class MarkRow:
    """From the board `run` on, `after` took the place of `before`. `board_type` is empty if it concerns all types."""

    started: str
    run: str
    kind: str
    board_type: str
    before: str
    after: str


@dataclass(frozen=True)
class Span:
    """Boards that came from `since` on and before `until`; of one type, or of all (None)."""

    since: str
    until: str
    board_type: str | None = None

    @property
    def condition(self) -> str:
        """The same as a condition in SQL, with `values` as its parameters."""
        return "started >= ? AND started < ?" + ("" if self.board_type is None else " AND board_type = ?")

    @property
    def values(self) -> tuple[str, ...]:
        """The values of the parameters of `condition`."""
        return (self.since, self.until, *(() if self.board_type is None else (self.board_type,)))


class BoardFigures:
    """Storage of the figures of one station's boards. Writes do not wait for the disk."""

    def __init__(self, database: Database) -> None:
        self._database = database
        self._added = 0
        self.has_only_lower_limit: Callable[[str], bool] = lambda _name: False
        """Function that returns whether the values of a figure are conspicuous only if they are low."""

    def add(self, row: BoardRow, made_with: Mapping[tuple[str, str], str], kept: int = MOST_BOARDS) -> Future[None]:
        """Add figures of a board; those that it has already stay as they are.

        Args:
            row: the figures.
            made_with: what the figures depend on, by (kind, board type or empty): a mark is written if it has changed.
            kept: number of boards to keep one by one.
        """
        self._added += 1
        # Also at the first one: a station that is started daily may never come to the number.
        prune = self._added == 1 or self._added % _EVERY == 0

        def write(connection: sqlite3.Connection) -> None:
            new = _add_board(connection, row)
            _add_to_hour(connection, row, new, self.has_only_lower_limit)
            _add_marks(connection, row, made_with)
            if prune:
                _forget(connection, row, kept)

        return self._database.write(write, patient=True, durable=False, size=50 * len(row.figures) + 500)

    def count(self, span: Span) -> int:
        """Return the number of boards of a span whose figures are kept one by one."""
        query = f"SELECT count(*) FROM board_figures WHERE {span.condition}"
        return int(self._database.value(query, span.values))

    def runs(self, span: Span, limit: int, every: int = 1) -> list[str]:
        """Return the runs of the first `limit` boards, or of every n-th of the boards, of a span, oldest first."""
        return self._database.column(
            f"""SELECT run FROM (SELECT run, row_number() OVER (ORDER BY started, run) AS n
                FROM board_figures WHERE {span.condition}) WHERE n % ? = 0 ORDER BY n LIMIT ?""",
            (*span.values, every, limit),
        )

    def boards(self, runs: Sequence[str]) -> Iterator[BoardRow]:
        """Yield the boards of runs in the order of the runs; those that were deleted meanwhile are left out."""
        for batch in _batches(runs):
            rows = self._database.read(f"SELECT * FROM board_figures WHERE run {ANY_OF}", (keys_of(batch),))
            found = {r["run"]: r for r in rows}
            for r in (found[run] for run in batch if run in found):
                yield BoardRow(r["run"], r["started"], r["board_type"], _read(r["document"]))

    def first_board(self) -> str | None:
        """Return the time of the oldest board whose figures are kept one by one; None without boards."""
        first: str | None = self._database.value("SELECT min(started) FROM board_figures")
        return first

    def hour_numbers(self, span: Span) -> list[int]:
        """Return which rows per hour lie in a span at least in part, oldest first; the newest `MOST_HOURS` of them.

        The first and the last hour are returned whole.
        """
        of_type = "" if span.board_type is None else " AND board_type = ?"
        rows = self._database.read(
            f"SELECT number FROM hourly_figures WHERE hour >= ? AND hour || ':00:00.000Z' < ?{of_type} "
            f"ORDER BY hour DESC LIMIT {MOST_HOURS}",
            (span.since[:13], *span.values[1:]),
        )
        return [int(row[0]) for row in reversed(rows)]

    def hours(self, numbers: Sequence[int]) -> Iterator[HourRow]:
        """Yield rows per hour in the order of their numbers; those that were deleted meanwhile are left out."""
        for batch in _batches(numbers):
            rows = self._database.read(f"SELECT * FROM hourly_figures WHERE number {ANY_OF}", (keys_of(batch),))
            found = {r["number"]: r for r in rows}
            for r in (found[number] for number in batch if number in found):
                yield HourRow(r["hour"], r["board_type"], {k: tuple(v) for k, v in _read(r["document"]).items()})

    def marks(self, span: Span, limit: int) -> list[MarkRow]:
        """Return what changed in a span, oldest first; the newest `limit` changes."""
        of_type = "" if span.board_type is None else " AND board_type IN ('', ?)"
        rows = self._database.read(
            f"""SELECT * FROM figure_marks WHERE started >= ? AND started < ?{of_type} AND before IS NOT NULL
                ORDER BY started DESC, kind LIMIT ?""",
            (*span.values, limit),
        )
        return [
            MarkRow(r["started"], r["run"], r["kind"], r["board_type"], r["before"], r["after"]) for r in reversed(rows)
        ]


def merged(a: HourFigure, b: HourFigure, *, only_lower_limit: bool = False) -> HourFigure:
    """Return one figure of two groups of boards together.

    Its run is that of the group with the larger magnitude; of a figure with only a lower limit, with the lesser value.
    """
    count = a[0] + b[0]
    b_worse = b[2] < a[2] if only_lower_limit else max(abs(b[2]), abs(b[3])) > max(abs(a[2]), abs(a[3]))
    return count, (a[0] * a[1] + b[0] * b[1]) / count, min(a[2], b[2]), max(a[3], b[3]), (b if b_worse else a)[4]


def _batches(keys: Sequence[T]) -> Iterator[tuple[T, ...]]:
    return (tuple(keys[n : n + _BATCH]) for n in range(0, len(keys), _BATCH))


def _read(document: str) -> dict[str, Any]:
    """Return the figures of a row; none if its text is damaged, which must not keep new figures from being added."""
    try:
        found: dict[str, Any] = json.loads(document)
    except ValueError:
        return {}
    return found


def _add_board(connection: sqlite3.Connection, row: BoardRow) -> dict[str, float]:
    """Add figures to the row of a board; return those that it did not have."""
    found = connection.execute("SELECT document FROM board_figures WHERE run = ?", (row.run,)).fetchone()
    known = _read(found[0]) if found else {}
    new = {name: value for name, value in row.figures.items() if name not in known}
    connection.execute(
        """INSERT INTO board_figures VALUES (?, ?, ?, ?)
           ON CONFLICT (run) DO UPDATE SET document = excluded.document""",
        (row.run, row.started, row.board_type, json.dumps(known | new, separators=(",", ":"))),
    )
    return new


def _add_to_hour(
    connection: sqlite3.Connection, row: BoardRow, new: Mapping[str, float], only_lower: Callable[[str], bool]
) -> None:
    hour = row.started[:13]
    found = connection.execute(
        "SELECT document FROM hourly_figures WHERE hour = ? AND board_type = ?", (hour, row.board_type)
    ).fetchone()
    figures = _read(found[0]) if found else {}
    for name, value in new.items():
        one: HourFigure = (1, value, value, value, row.run)
        figures[name] = merged(figures[name], one, only_lower_limit=only_lower(name)) if name in figures else one
    connection.execute(
        """INSERT INTO hourly_figures (hour, board_type, document) VALUES (?, ?, ?)
           ON CONFLICT (hour, board_type) DO UPDATE SET document = excluded.document""",
        (hour, row.board_type, json.dumps(figures, separators=(",", ":"))),
    )


def _add_marks(connection: sqlite3.Connection, row: BoardRow, made_with: Mapping[tuple[str, str], str]) -> None:
    for (kind, board_type), value in made_with.items():
        found = connection.execute(
            "SELECT after FROM figure_marks WHERE kind = ? AND board_type = ? ORDER BY number DESC LIMIT 1",
            (kind, board_type),
        ).fetchone()
        if found is None or found[0] != value:
            # The first value of all is no change, but the next board is compared with it.
            before = None if found is None else found[0]
            connection.execute(
                """INSERT INTO figure_marks (kind, board_type, started, run, before, after)
                   VALUES (?, ?, ?, ?, ?, ?)""",
                (kind, board_type, row.started, row.run, before, value),
            )


def _forget(connection: sqlite3.Connection, row: BoardRow, kept: int) -> None:
    """Delete what is too old."""
    connection.execute(
        """DELETE FROM board_figures WHERE started < (
           SELECT started FROM board_figures ORDER BY started DESC LIMIT 1 OFFSET ?)""",
        (kept - 1,),
    )
    oldest = f"{int(row.started[:4]) - HOURS_YEARS}{row.started[4:13]}"
    connection.execute("DELETE FROM hourly_figures WHERE hour < ?", (oldest,))
    # The newest value of each kind stays: the next board is compared with it.
    connection.execute(
        """DELETE FROM figure_marks WHERE number <= (SELECT max(number) FROM figure_marks) - ?
           AND number NOT IN (SELECT max(number) FROM figure_marks GROUP BY kind, board_type)""",
        (MOST_MARKS,),
    )
