"""Comparison of two spans: which figures changed by more than their spread from board to board."""

from __future__ import annotations

import math
from array import array
from collections import defaultdict
from collections.abc import Iterable, Sequence

import numpy as np

from vaoi_station.runs.trends.figures import FIGURES
from vaoi_station.runs.trends.trend_schemas import SpanFigure, TrendChange
from vaoi_station.store.history.board_figures import BoardRow

LEAST_BOARDS = 5
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
    keys = [k for k in earlier if k in later and min(len(earlier[k]), len(later[k])) >= LEAST_BOARDS]
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
    earlier, later = summary(before), summary(now)
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


def _figure(values: Sequence[float]) -> SpanFigure:
    """Return median and spread of the values of a span."""
    array = np.asarray(values)
    median = float(np.median(array))
    spread = _NORMAL * float(np.median(np.abs(array - median))) if len(values) >= _FEW else 0.0
    spread = spread or float(array.std(ddof=1))
    return _rounded(values, median, spread)


def _count(values: Sequence[float]) -> SpanFigure:
    """Return the mean of counts, which are 0 on most boards, and by how much chance may change this mean."""
    array = np.asarray(values)
    return _rounded(values, float(array.mean()), _CHANCE * float(array.std()) / math.sqrt(len(values)))


def _rounded(values: Sequence[float], middle: float, spread: float) -> SpanFigure:
    return SpanFigure(boards=len(values), middle=float(f"{middle:.5g}"), spread=float(f"{spread:.3g}"))
