"""The history of figures of one station: filled when runs end and when they are checked, asked by callers."""

from __future__ import annotations

import logging
import threading
from collections import OrderedDict
from collections.abc import Callable, Iterator, Sequence
from contextlib import contextmanager
from dataclasses import replace

from vaoi_station.drift.checks import RunCheck
from vaoi_station.errors import DeviceError, StateError
from vaoi_station.model import Stitch
from vaoi_station.runs.states.schemas import RunDetail
from vaoi_station.runs.trends.comparison import compare
from vaoi_station.runs.trends.figures import figures_of, figures_of_check, has_only_lower_limit, made_with_of
from vaoi_station.runs.trends.thinning import (
    MOST_SERIES,
    SingleBoards,
    bin_width_s,
    groups_of_boards,
    groups_of_hours,
    series_of_groups,
    single_boards,
)
from vaoi_station.runs.trends.trend_schemas import TrendComparison, TrendMark, Trends
from vaoi_station.store.history.board_figures import (
    BYTES_PER_BOARD,
    LEAST_BOARDS,
    MOST_BOARDS,
    MOST_HOURS,
    SHARE,
    BoardFigures,
    BoardRow,
    MarkRow,
    Span,
)

_log = logging.getLogger(__name__)

MOST_READ = 5000
"""Largest number of boards that one request reads one by one, a day at a board every 20 s; of more boards, it reads the
figures per hour, which takes less of the time of the station's process."""
MOST_COMPARED = 4000
"""Largest number of boards of each span that a comparison reads; of more boards, it reads every n-th."""
MOST_MARKS = 200
"""Largest number of marks in one answer."""
_RECENT = 200
"""Number of runs whose check may be late, or early."""
HOUR_S = 3600.0


class TrendHistory:
    """Keeps the figures of boards, and returns their development. Its methods may be called from any thread."""

    def __init__(self, figures: BoardFigures, cameras: Sequence[str], database_gb: float) -> None:
        self._figures, self._cameras = figures, tuple(cameras)
        figures.has_only_lower_limit = has_only_lower_limit
        most = int(database_gb * 1e9 * SHARE / BYTES_PER_BOARD)
        self._kept = min(max(most, LEAST_BOARDS), MOST_BOARDS)
        self._recent: OrderedDict[str, BoardRow] = OrderedDict()
        """Boards that wait for their check, and figures of checks that wait for the end of their run (no type)."""
        self._joining = threading.Lock()

    def finished(self, detail: RunDetail, stitch_of: Callable[[str], Stitch | None]) -> None:
        """Keep the figures of a run that has ended; it returns at once, and raises nothing."""
        with _faults_logged(detail.id):
            row = BoardRow(detail.id, detail.started, detail.board_type, {})
            earlier = self._join(row)
            figures = figures_of(detail, stitch_of(detail.id)) | (dict(earlier.figures) if earlier else {})
            self._figures.add(replace(row, figures=figures), made_with_of(detail), self._kept)

    def checked(self, check: RunCheck) -> None:
        """Keep the figures of a drift check, which may come before or after the end of its run, as `finished` does."""
        with _faults_logged(check.run):
            figures = figures_of_check(check, self._cameras)
            row = self._join(BoardRow(check.run, "", "", figures))
            if row is not None:
                self._figures.add(replace(row, figures=figures), {}, self._kept)

    def trends(self, span: Span, wanted: Sequence[str], points: int) -> Trends:
        """Return the figures of a span: of each board, or of at most `points` bins if there are more boards."""
        runs, first = self._figures.runs(span, MOST_READ + 1), self._figures.first_board()
        hours: list[int] = []
        if first is None or span.since < first or len(runs) > MOST_READ:
            hours = self._figures.hour_numbers(span)
        # Figures per hour go further back than those of single boards.
        oldest = next(self._figures.hours(hours[:1]), None)
        by_hour = len(runs) > MOST_READ or (oldest is not None and oldest.hour < (first or span.until)[:13])
        marks = self._figures.marks(span, MOST_MARKS + 1)
        width_s, groups, single = None, [], SingleBoards((), (), [])
        if not by_hour and len(runs) <= points:
            single = single_boards(self._figures.boards(runs), wanted)
            series = single.series
        else:
            width_s = bin_width_s(span, points, HOUR_S if by_hour else 0.0)
            if by_hour:
                groups = groups_of_hours(self._figures.hours(hours), width_s)
            else:
                groups = groups_of_boards(self._figures.boards(runs), width_s)
            series = series_of_groups(groups, wanted)
        whole = len(series) <= MOST_SERIES and len(marks) <= MOST_MARKS and len(hours) < MOST_HOURS
        return Trends(
            since=span.since,
            until=span.until,
            board_type=span.board_type,
            boards=sum(group.boards for group in groups) if width_s else len(single.runs),
            bin_s=width_s,
            times=tuple(group.time for group in groups) if width_s else single.times,
            runs=None if width_s else single.runs,
            counts=tuple(group.boards for group in groups) if width_s else (1,) * len(single.runs),
            series=tuple(series[:MOST_SERIES]),
            marks=tuple(_mark(mark) for mark in marks[-MOST_MARKS:]),
            complete=whole,
        )

    def figures(self, runs: Sequence[str]) -> dict[str, dict[str, float]]:
        """Return the figures of runs by run id and `key_of`; runs of which none are kept one by one are left out."""
        try:
            return {row.run: dict(row.figures) for row in self._figures.boards(runs)}
        except DeviceError:
            return {}  # The disk cannot be read: runs are shown without them.

    def compared(self, before: Span, now: Span) -> TrendComparison:
        """Return which figures changed between two spans of one board type, or of all."""
        around = Span(min(before.since, now.since), max(before.until, now.until), now.board_type)
        counts = [self._figures.count(span) for span in (before, now)]
        rows = [
            self._figures.boards(self._figures.runs(span, MOST_COMPARED, every=-(-count // MOST_COMPARED) or 1))
            for span, count in zip((before, now), counts, strict=True)
        ]
        return TrendComparison(
            before_since=before.since,
            before_until=before.until,
            since=now.since,
            until=now.until,
            board_type=now.board_type,
            before_boards=counts[0],
            boards=counts[1],
            changes=compare(*rows),
            marks=tuple(_mark(mark) for mark in self._figures.marks(around, MOST_MARKS)),
        )

    def _join(self, row: BoardRow) -> BoardRow | None:
        """Return the other part of a board if it came before; else keep this one until the other comes."""
        with self._joining:
            other = self._recent.pop(row.run, None)
            if other is None:
                self._recent[row.run] = row
                if len(self._recent) > _RECENT:
                    self._recent.popitem(last=False)
            return other


@contextmanager
def _faults_logged(run: str) -> Iterator[None]:
    """Log a fault of a `with` block instead of raising it: figures must not keep a result from being announced."""
    try:
        yield
    except StateError:
        _log.info("figures of run %s were not kept: the station is stopping", run)
    except Exception:  # noqa: BLE001  results and later checks must go on without these figures
        _log.warning("figures of run %s were not kept", run, exc_info=True)


def _mark(row: MarkRow) -> TrendMark:
    return TrendMark.model_validate(
        {
            "time": row.started,
            "run": row.run,
            "kind": row.kind,
            "board_type": row.board_type or None,
            "before": row.before,
            "after": row.after,
        }
    )
