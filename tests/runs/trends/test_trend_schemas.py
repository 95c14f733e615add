"""Documents about trends have the kinds of marks that runs can leave."""

from __future__ import annotations

import re
from inspect import getsource
from typing import get_args

from vaoi_station.runs.trends import figures
from vaoi_station.runs.trends.trend_schemas import MarkKind, TrendSeries


def test_every_kind_of_mark_is_named() -> None:
    kinds = set(re.findall(r'\("?([a-z-]+)", (?:""|name)\)', getsource(figures.made_with_of)))
    assert kinds | {"light"} == set(get_args(MarkKind))


def test_a_series_without_bins_has_neither_extremes_nor_runs() -> None:
    series = TrendSeries(figure="ready_ms", at=(0,), values=(1.0,))
    assert series.model_dump(exclude_none=True) == {"figure": "ready_ms", "part": "", "at": (0,), "values": (1.0,)}
