"""How the figures of boards develop: kept when runs end, thinned for long spans, compared between two spans."""

from __future__ import annotations

import logging
import math
import threading
from array import array
from collections import Counter, OrderedDict, defaultdict
from collections.abc import Callable, Iterable, Iterator, Mapping, Sequence
from contextlib import contextmanager
from dataclasses import replace
from datetime import UTC, datetime
from typing import Literal, NamedTuple

import numpy as np

from vaoi_station.drift.checks import RunCheck
from vaoi_station.errors import DeviceError, StateError
from vaoi_station.model import Stitch, Strict
from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.states.schemas import RunDetail
from vaoi_station.runs.trends.figures import FIGURES, figures_of, figures_of_check, has_only_lower_limit, made_with_of
from vaoi_station.stitching.quality.verdict import OK_SIGMA_PX
from vaoi_station.store.figures import (
    BYTES_PER_BOARD,
    LEAST_BOARDS,
    MOST_BOARDS,
    MOST_HOURS,
    SHARE,
    BoardFigures,
    BoardRow,
    HourFigure,
    HourRow,
    MarkRow,
    Span,
    merged,
)

MarkKind = Literal["calibration", "configuration", "board-type", "light", "reference", "software", "restart"]


class TrendSeries(Strict):
    """One figure over time."""

    figure: str
    """Name of the figure, with its unit."""
    part: str = ""
    """What the figure is of: a pair of cameras, a camera, a camera and a light ("left/ring"); empty: the board."""
    lower: float | None = None
    """Limit below which a value is conspicuous; None without such a limit."""
    upper: float | None = None
    """Limit above which a value is conspicuous."""
    at: tuple[int, ...]
    """Index in `times` of every value: some boards do not have the figure."""
    values: tuple[float, ...]
    """Value of the board, or mean of the boards."""
    least: tuple[float, ...] | None = None
    """Least value of the boards; None if each time is that of one board."""
    largest: tuple[float, ...] | None = None
    runs: tuple[str, ...] | None = None
    """Run with the largest magnitude, of brightness the darkest; None if each time is that of one board."""


class TrendMark(Strict):
    """From this board on, something that figures depend on was another."""

    time: str
    run: str
    kind: MarkKind
    board_type: str | None = None
    """The board type that it concerns; None: all."""
    before: str
    """Digest, version, run of the reference, lights with their exposures, or start of the station; empty: none."""
    after: str


class Trends(Strict):
    """Figures of the boards of a span."""

    since: str
    until: str
    board_type: str | None = None
    boards: int
    """Number of boards in the span."""
    bin_s: float | None = None
    """Each value is of the boards of this many seconds from its time on; None: of one board."""
    times: tuple[str, ...]
    """Times at which boards came, or begin of each bin; bins without boards are left out."""
    runs: tuple[str, ...] | None = None
    """Run of each of the times; None with bins."""
    counts: tuple[int, ...]
    """Number of boards of each of the times."""
    series: tuple[TrendSeries, ...]
    marks: tuple[TrendMark, ...]
    complete: bool
    """Whether all series, marks and times of the span are there; False: the newest, or the first series by name."""


class SpanFigure(Strict):
    """One figure of the boards of a span."""

    boards: int
    """Number of boards with this figure."""
    middle: float
    """Median; of counts (`lost_frames`, `unseen_parts`), which are 0 on most boards, the mean."""
    spread: float
    """Standard deviation from board to board, from the median absolute deviation; of counts, three standard deviations
    of the mean."""


class TrendChange(Strict):
    """How one figure differs between two spans."""

    figure: str
    part: str
    before: SpanFigure
    now: SpanFigure
    change: float
    """`middle` of now minus that of before."""
    spreads: float
    """Magnitude of the change divided by the larger of both spreads; the list is sorted by it."""
    changed: bool
    """Whether the change is larger than the spread, and larger than chance explains."""
    worse: bool | None = None
    """Whether the figure has become worse; None if neither direction is better."""


class TrendComparison(Strict):
    """Which figures changed between two spans by more than their spread, the largest change first."""

    before_since: str
    before_until: str
    since: str
    until: str
    board_type: str | None = None
    before_boards: int
    boards: int
    changes: tuple[TrendChange, ...]
    """All figures that both spans have, also those that did not change."""
    marks: tuple[TrendMark, ...]
    """What changed between the begin of the earlier span and the end of the later one."""


_log = logging.getLogger(__name__)

MOST_READ = 5000
"""Largest number of boards that one request reads one by one; of more boards, it reads the figures per hour."""
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
        self._figures, self._cameras, self._begun = figures, tuple(cameras), utc()
        figures.has_only_lower_limit = has_only_lower_limit
        most = int(database_gb * 1e9 * SHARE / BYTES_PER_BOARD)
        self._kept = min(max(most, LEAST_BOARDS), MOST_BOARDS)
        self._recent: OrderedDict[str, BoardRow] = OrderedDict()
        """Boards that wait for their check, and figures of checks that wait for the end of their run (no type)."""
        self._joining = threading.Lock()
        self.sigma_limit_px = OK_SIGMA_PX
        """Limit of the verdict at the station's resolution, which lines of `sigma_px` show."""

    def finished(self, detail: RunDetail, stitch_of: Callable[[str], Stitch | None]) -> None:
        """Keep the figures of a run that has ended; it returns at once, and raises nothing."""
        with _faults_logged(detail.id):
            row = BoardRow(detail.id, detail.started, detail.board_type, {})
            earlier = self._join(row)
            figures = figures_of(detail, stitch_of(detail.id)) | (dict(earlier.figures) if earlier else {})
            made_with = made_with_of(detail) | {("restart", ""): self._begun}
            self._figures.add(replace(row, figures=figures), made_with, self._kept)

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
        width_s, of = None, None
        if not by_hour and len(runs) <= points:
            times, of, series = single_boards(self._figures.boards(runs), wanted)
            counts = (1,) * len(of)
        else:
            width_s = bin_width_s(span, points, HOUR_S if by_hour else 0.0)
            if by_hour:
                groups = groups_of_hours(self._figures.hours(hours), width_s)
            else:
                groups = groups_of_boards(self._figures.boards(runs), width_s)
            times, series = tuple(group.time for group in groups), series_of_groups(groups, wanted)
            counts = tuple(group.boards for group in groups)
        series = [
            line.model_copy(update={"upper": self.sigma_limit_px}) if line.figure == "sigma_px" else line
            for line in series
        ]
        return Trends(
            since=span.since,
            until=span.until,
            board_type=span.board_type,
            boards=sum(counts),
            bin_s=width_s,
            times=times,
            runs=of,
            counts=counts,
            series=tuple(series[:MOST_SERIES]),
            marks=tuple(_mark(mark) for mark in marks[-MOST_MARKS:]),
            complete=len(series) <= MOST_SERIES and len(marks) <= MOST_MARKS and len(hours) < MOST_HOURS,
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
    fields = {"time": row.started, "run": row.run, "kind": row.kind, "board_type": row.board_type or None}
    return TrendMark.model_validate(fields | {"before": row.before, "after": row.after})


MOST_SERIES = 200
"""Largest number of series in one answer."""
BINS_S = (60, 120, 300, 600, 900, 1800, 3600, 7200, 10800, 21600, 43200, 86400, 7 * 86400)
"""Widths of bins, s; a week is the widest."""


class Group(NamedTuple):
    """The boards of one time."""

    time: str
    boards: int
    figures: Mapping[str, HourFigure]


def bin_width_s(span: Span, points: int, least_s: float = 0.0) -> float:
    """Return the width of the bins, s, with which a span has at most `points` of them, if a week suffices."""
    length_s = (datetime.fromisoformat(span.until) - datetime.fromisoformat(span.since)).total_seconds()
    return next((float(s) for s in BINS_S if s >= least_s and length_s / s <= points), float(BINS_S[-1]))


def groups_of_boards(rows: Iterable[BoardRow], width_s: float) -> list[Group]:
    """Return boards in bins of a width, oldest first."""
    return _binned(((r.started, {k: (1, v, v, v, r.run) for k, v in r.figures.items()}, 1) for r in rows), width_s)


def groups_of_hours(rows: Iterable[HourRow], width_s: float) -> list[Group]:
    """Return hours in bins of a width, oldest first. Every board has the figure `lost_frames`, which counts them."""
    entries = ((f"{r.hour}:00:00.000Z", r.figures, max((f[0] for f in r.figures.values()), default=0)) for r in rows)
    return _binned(entries, width_s)


def single_boards(
    rows: Iterable[BoardRow], wanted: Sequence[str]
) -> tuple[tuple[str, ...], tuple[str, ...], list[TrendSeries]]:
    """Return times and runs of boards, and one series per figure with the value of every board."""
    times, runs = [], []
    columns: dict[str, tuple[list[int], list[float]]] = defaultdict(lambda: ([], []))
    for n, row in enumerate(rows):
        times.append(row.started)
        runs.append(row.run)
        for key, value in row.figures.items():
            columns[key][0].append(n)
            columns[key][1].append(value)
    series = [_series(key, tuple(columns[key][0]), tuple(columns[key][1])) for key in _keys([columns], wanted)]
    return tuple(times), tuple(runs), series


def series_of_groups(groups: Sequence[Group], wanted: Sequence[str]) -> list[TrendSeries]:
    """Return one series per figure with mean, least and largest value of every group."""
    found = []
    for key in _keys((g.figures for g in groups), wanted):
        at = tuple(n for n, group in enumerate(groups) if key in group.figures)
        cells = [groups[n].figures[key] for n in at]
        _, means, least, largest, runs = zip(*cells, strict=True)
        series = _series(key, at, tuple(float(f"{mean:.5g}") for mean in means))
        found.append(series.model_copy(update={"least": least, "largest": largest, "runs": runs}))
    return found


def _series(key: str, at: tuple[int, ...], values: tuple[float, ...]) -> TrendSeries:
    figure, _, part = key.partition(":")
    known = FIGURES[figure]
    return TrendSeries(figure=figure, part=part, lower=known.lower, upper=known.upper, at=at, values=values)


def _keys(rows: Iterable[Mapping[str, object]], wanted: Sequence[str]) -> list[str]:
    """Return the names of all wanted figures that rows have, in the order of `FIGURES`. No names want all."""
    names = list(FIGURES)
    found = {key for row in rows for key in row}
    chosen = [key for key in found if (figure := key.partition(":")[0]) in FIGURES and figure in (wanted or names)]
    return sorted(chosen, key=lambda key: (names.index(key.partition(":")[0]), key))


def _binned(entries: Iterable[tuple[str, Mapping[str, HourFigure], int]], width_s: float) -> list[Group]:
    # Only the totals of each bin are kept: memory does not grow with the number of entries.
    bins: dict[float, dict[str, HourFigure]] = defaultdict(dict)
    counts: Counter[float] = Counter()
    for time, figures, boards in entries:
        number = datetime.fromisoformat(time).timestamp() // width_s
        counts[number] += boards
        totals = bins[number]
        for key, figure in figures.items():
            known = totals.get(key)
            only_lower = has_only_lower_limit(key)
            totals[key] = figure if known is None else merged(known, figure, only_lower_limit=only_lower)
    return [
        Group(utc(datetime.fromtimestamp(number * width_s, UTC)), counts[number], bins[number])
        for number in sorted(bins)
    ]


LEAST_COMPARED = 5
"""Number of boards that each span must have for a figure to be compared."""
_FEW = 20
"""Number of boards below which the median absolute deviation is too uncertain, and the standard deviation counts."""
_NORMAL = 1.4826
"""Standard deviation of a normal distribution divided by its median absolute deviation."""
_CHANCE = 3.0
"""Standard deviations of the difference of two medians that chance explains."""
_MEDIAN = 1.2533
"""Standard deviation of a median divided by that of a mean, for a normal distribution."""
_MOST_SPREADS = 1000.0


def compare(before: Iterable[BoardRow], now: Iterable[BoardRow]) -> tuple[TrendChange, ...]:
    """Return how all figures that both spans have differ, the largest change in spreads first."""
    earlier, later = _columns(before), _columns(now)
    keys = [k for k in earlier if k in later and min(len(earlier[k]), len(later[k])) >= LEAST_COMPARED]
    changes = [_change(key, earlier[key], later[key]) for key in keys if key.partition(":")[0] in FIGURES]
    return tuple(sorted(changes, key=lambda c: (not c.changed, -c.spreads, c.figure, c.part)))


def _columns(rows: Iterable[BoardRow]) -> dict[str, array[float]]:
    columns: dict[str, array[float]] = defaultdict(lambda: array("d"))
    for row in rows:
        for key, value in row.figures.items():
            columns[key].append(value)
    return columns


def _change(key: str, before: Sequence[float], now: Sequence[float]) -> TrendChange:
    figure, _, part = key.partition(":")
    summary = _count if FIGURES[figure].counts else _figure
    earlier, later = (
        SpanFigure(boards=len(values), middle=float(f"{middle:.5g}"), spread=float(f"{spread:.3g}"))
        for values in (before, now)
        for middle, spread in [summary(values)]
    )
    change = later.middle - earlier.middle
    spread = max(earlier.spread, later.spread)
    error = _MEDIAN * math.hypot(earlier.spread / math.sqrt(len(before)), later.spread / math.sqrt(len(now)))
    spreads = 0.0 if change == 0 else min(abs(change) / spread, _MOST_SPREADS) if spread > 0 else _MOST_SPREADS
    better = FIGURES[figure].better
    return TrendChange(
        figure=figure,
        part=part,
        before=earlier,
        now=later,
        change=float(f"{change:.5g}"),
        spreads=round(spreads, 3),
        changed=spreads > 1 and (FIGURES[figure].counts or abs(change) > _CHANCE * error),
        worse=None if better == 0 or change == 0 else change * better < 0,
    )


def _figure(values: Sequence[float]) -> tuple[float, float]:
    """Return median and spread of the values of a span."""
    array = np.asarray(values)
    median = float(np.median(array))
    spread = _NORMAL * float(np.median(np.abs(array - median))) if len(values) >= _FEW else 0.0
    return median, spread or float(array.std(ddof=1))


def _count(values: Sequence[float]) -> tuple[float, float]:
    """Return the mean of counts, which are 0 on most boards, and by how much chance may change this mean."""
    array = np.asarray(values)
    return float(array.mean()), _CHANCE * float(array.std()) / math.sqrt(len(values))
