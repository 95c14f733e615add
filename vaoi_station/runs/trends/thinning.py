"""Series of figures from boards or from hours: one value per board, or per bin of time if there are too many boards."""

from __future__ import annotations

from collections import Counter, defaultdict
from collections.abc import Iterable, Mapping, Sequence
from datetime import UTC, datetime, timedelta
from typing import NamedTuple

from vaoi_station.runs.states.run_ids import utc
from vaoi_station.runs.trends.figures import FIGURES, has_only_lower_limit
from vaoi_station.runs.trends.trend_schemas import TrendSeries
from vaoi_station.store.history.board_figures import BoardRow, FigureTotal, HourFigure, HourRow, Span

MOST_SERIES = 200
"""Largest number of series in one answer."""
BINS_S = (60, 120, 300, 600, 900, 1800, 3600, 7200, 10800, 21600, 43200, 86400, 7 * 86400)
"""Widths of bins, s; a week is the widest."""


class Group(NamedTuple):
    """The boards of one time."""

    time: str
    boards: int
    figures: Mapping[str, HourFigure]


class SingleBoards(NamedTuple):
    """Boards one by one."""

    times: tuple[str, ...]
    runs: tuple[str, ...]
    series: list[TrendSeries]


def bin_width_s(span: Span, points: int, least_s: float = 0.0) -> float:
    """Return the width of the bins, s, with which a span has at most `points` of them, if a week suffices."""
    length_s = (_moment(span.until) - _moment(span.since)).total_seconds()
    return next((float(s) for s in BINS_S if s >= least_s and length_s / s <= points), float(BINS_S[-1]))


def groups_of_boards(rows: Iterable[BoardRow], width_s: float) -> list[Group]:
    """Return boards in bins of a width, oldest first."""
    return _binned(((r.started, {k: (1, v, v, v, r.run) for k, v in r.figures.items()}, 1) for r in rows), width_s)


def groups_of_hours(rows: Iterable[HourRow], width_s: float) -> list[Group]:
    """Return hours in bins of a width, oldest first. Every board has the figure `lost_frames`, which counts them."""
    entries = ((f"{r.hour}:00:00.000Z", r.figures, max((f[0] for f in r.figures.values()), default=0)) for r in rows)
    return _binned(entries, width_s)


def single_boards(rows: Iterable[BoardRow], wanted: Sequence[str]) -> SingleBoards:
    """Return boards, and one series per figure with the value of every board."""
    times, runs = [], []
    columns: dict[str, tuple[list[int], list[float]]] = defaultdict(lambda: ([], []))
    for n, row in enumerate(rows):
        times.append(row.started)
        runs.append(row.run)
        for key, value in row.figures.items():
            at, values = columns[key]
            at.append(n)
            values.append(value)
    series = [_series(key, tuple(columns[key][0]), tuple(columns[key][1])) for key in _keys([columns], wanted)]
    return SingleBoards(tuple(times), tuple(runs), series)


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
    bins: dict[float, dict[str, FigureTotal]] = defaultdict(dict)
    counts: Counter[float] = Counter()
    for time, figures, boards in entries:
        number = _moment(time).timestamp() // width_s
        counts[number] += boards
        totals = bins[number]
        for key, figure in figures.items():
            if key not in totals:
                totals[key] = FigureTotal(only_lower_limit=has_only_lower_limit(key))
            totals[key].add(figure)
    groups = []
    for number in sorted(bins):
        begin = utc(datetime(1970, 1, 1, tzinfo=UTC) + timedelta(seconds=number * width_s))
        groups.append(Group(begin, counts[number], {key: total.figure() for key, total in bins.pop(number).items()}))
    return groups


def _moment(time: str) -> datetime:
    return datetime.fromisoformat(time)
