"""Figures as JSON and as Markdown tables."""

from __future__ import annotations

import json
import math
from dataclasses import replace

import pytest

from vaoi_station.benchmarks.growth import ScalingFigures, scaling_table
from vaoi_station.benchmarks.station_pace import RateFigures, process_table, station_table
from vaoi_station.benchmarks.tables import json_document, number


def test_numbers_that_json_lacks_become_null_at_any_depth() -> None:
    document = json_document({"a": math.nan, "b": [1.5, {"c": math.inf}], "d": (1, "x", None, True, -math.inf)})
    assert document == {"a": None, "b": [1.5, {"c": None}], "d": [1, "x", None, True, None]}
    json.dumps(document, allow_nan=False)


@pytest.mark.parametrize(
    ("value", "text"), [(1.256, "1.26"), (0.0, "0.00"), (None, "–"), (math.nan, "–"), (math.inf, "–")]
)
def test_an_absent_figure_is_a_dash(value: float | None, text: str) -> None:
    assert number(value, 2) == text


SCALING = ScalingFigures(12, 4, (90.0, 61.4), 33, 2.125, 0.5, 7.25, 3.7, "ok", ())
RATE = RateFigures(
    rate=2.0,
    frames_per_s=16.16,
    mbit_per_s=2223.4,
    boards=12,
    boards_missed=0,
    frames_lost=0,
    kept_up=True,
    ready_after_last_frame_ms={"median": 41.2, "p99": 55.9, "max": 55.9},
    conclude_ms=31.4,
    lag_first_half_ms=12.2,
    lag_second_half_ms=12.6,
    links_open_at_last_frame=3,
    cpu_ms_per_frame={"station": 0.1, "worker 0": 2.5, "sender": 0.5},
    cores=0.51,
    sender_cores=0.1,
    memory_mb={"station": 80.0, "worker 0": 120.4, "sender": 30.0},
    statuses={"ok": 12},
    load_before=0.3,
    each=(),
)


def cells(line: str) -> list[str]:
    return [cell.strip() for cell in line.strip("|").split("|")]


def test_station_table_has_one_row_per_rate() -> None:
    head, rule, first, second = station_table([RATE, replace(RATE, rate=4.0, kept_up=False)]).splitlines()
    assert len(cells(head)) == len(cells(rule)) == len(cells(first))
    row = dict(zip(cells(head), cells(first), strict=True))
    assert (row["rate"], row["kept up"], row["ready ms (median, p99)"]) == ("2×", "yes", "41, 56")
    assert (row["link lag ms"], row["cores"], row["sender cores"]) == ("12 → 13", "0.51", "0.10")
    assert cells(second)[0] == "4×"
    assert "no" in cells(second)


def test_process_table_has_one_row_per_process_and_a_column_per_rate() -> None:
    lines = process_table([RATE, replace(RATE, rate=4.0)]).splitlines()
    assert cells(lines[0]) == ["process", "2×: CPU ms/frame, MB", "4×: CPU ms/frame, MB"]
    assert [cells(line)[0] for line in lines[2:]] == ["station", "worker 0", "sender"]
    assert cells(lines[3])[1] == "2.50, 120"


@pytest.mark.parametrize("count", [1, 3])
def test_scaling_table_has_one_row_per_board(count: int) -> None:
    lines = scaling_table([SCALING] * count).splitlines()
    assert len(lines) == 2 + count
    assert cells(lines[2]) == ["12", "4", "90 × 61", "33", "2.12", "0.50", "7.2", "4"]
