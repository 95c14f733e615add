"""Figures of a station in real time: their computation, and one small station that runs."""

from __future__ import annotations

import json
import math
from collections.abc import Iterator
from dataclasses import replace
from typing import Any

import pytest

from vaoi_station.benchmarks.station.prerendered_run import PrerenderedRun
from vaoi_station.benchmarks.station.station_pace import (
    BoardFigures,
    RateFigures,
    StationUsage,
    board_figures,
    measure_station_pace,
    rate_figures,
)
from vaoi_station.benchmarks.station.tables import process_table, station_table
from vaoi_station.runs.states.schemas import RunDetail, Timings, VerdictCounts
from vaoi_station.runs.states.timeline_schemas import TaskTiming, Timeline
from vaoi_station.simulation import Scenario

BOARDS, RATE = 2, 2.0
BOARD = BoardFigures("finished", "ok", 12, 0, 40.0, 25.0, 1, 10.0, 11.0)
USAGE = StationUsage(0.5, 0, {"station": 0.2, "worker 0": 1.0, "sender": 0.3}, {"station": 80.0})


def run_detail(rows: int, timings: Timings, counts: VerdictCounts) -> RunDetail:
    """Return the part of a run's details from which figures are computed."""
    part: dict[str, Any] = {"state": "finished", "verdict": "ok", "rows": rows, "counts": counts, "timings": timings}
    return RunDetail.model_construct(**part)


def task(row: int, other_row: int | None, ready_s: float, done_s: float) -> TaskTiming:
    other_camera = None if other_row is None else 0
    return TaskTiming(
        kind="links",
        camera=0,
        row=row,
        other_camera=other_camera,
        other_row=other_row,
        ready_s=ready_s,
        done_s=done_s,
        worker_ms=1,
    )


def timings(ready_ms: float | None) -> Timings:
    return Timings(
        filming_s=1, ready_after_last_frame_ms=ready_ms, links_ms=4, conclude_ms=7.126, links=4, links_while_filming=2
    )


def test_figures_of_a_board_come_from_the_times_of_its_tasks() -> None:
    tasks = (
        task(0, None, 0.1, 0.11),
        task(0, 1, 0.2, 0.23),
        task(1, 2, 0.3, 0.38),
        task(2, 3, 0.4, 0.50),
        task(1, None, 0.2, 0.42),
    )
    timeline = Timeline(frames_settled_s=(), tasks=tasks, last_frame_s=0.4, ready_s=0.55)
    counts = VerdictCounts.model_construct(ok=7, missing=2, incomplete=1)
    figures = board_figures(run_detail(4, timings(52.0), counts), timeline)
    assert (figures.frames, figures.lost, figures.status) == (7, 3, "ok")
    assert (figures.ready_after_last_frame_ms, figures.conclude_ms) == (52.0, 7.13)
    assert figures.links_open_at_last_frame == 1, "tasks of the last row do not count"
    assert figures.lag_first_half_ms == pytest.approx(30.0), "10, 30 and 220 ms"
    assert figures.lag_second_half_ms == pytest.approx(90.0), "80 and 100 ms"


def test_run_without_a_result_counts_as_infinitely_slow() -> None:
    timeline = Timeline(
        frames_settled_s=(), tasks=(task(0, None, 0, 1), task(1, None, 0, 1)), last_frame_s=1, ready_s=None
    )
    counts = VerdictCounts.model_construct(ok=2, missing=0, incomplete=0)
    assert math.isinf(board_figures(run_detail(2, timings(None), counts), timeline).ready_after_last_frame_ms)


def test_figures_of_a_rate_relate_cpu_time_to_frames_and_passing_time(small_run: PrerenderedRun) -> None:
    head = small_run.head
    slow = replace(BOARD, ready_after_last_frame_ms=90.0, status="degraded")
    figures = rate_figures(head, 2.0, (BOARD, BOARD, slow), USAGE)
    assert figures.frames_per_s == pytest.approx(2 / head.trigger_period_s, abs=0.01)
    assert figures.ready_after_last_frame_ms == {"median": 40.0, "p99": 90.0, "max": 90.0}
    assert figures.statuses == {"degraded": 1, "ok": 2}
    passing_s = 36 / (2 / head.trigger_period_s * 2)
    assert figures.cores == pytest.approx(1.2 / passing_s, abs=1e-3), "without the sender"
    assert figures.sender_cores == pytest.approx(0.3 / passing_s, abs=1e-3)
    assert figures.cpu_ms_per_frame["worker 0"] == pytest.approx(1000 / 36, abs=1e-3)
    assert figures.document()["each"][2]["status"] == "degraded"


@pytest.mark.parametrize(
    ("board", "missed", "kept_up"),
    [
        (BOARD, 0, True),
        (replace(BOARD, links_open_at_last_frame=4), 0, True),
        (replace(BOARD, links_open_at_last_frame=5), 0, False),
        (replace(BOARD, lost=1), 0, False),
        (BOARD, 1, False),
    ],
)
def test_station_keeps_up_without_losses_and_with_at_most_one_row_of_open_links(
    small_run: PrerenderedRun, board: BoardFigures, missed: int, kept_up: bool
) -> None:
    usage = USAGE._replace(boards_missed=missed)
    assert rate_figures(small_run.head, 1.0, (BOARD, board), usage).kept_up is kept_up


@pytest.mark.parametrize("boards", [(), (replace(BOARD, frames=0, lost=12),)])
def test_figures_without_boards_or_frames_are_absent_and_do_not_count_as_kept_up(
    small_run: PrerenderedRun, boards: tuple[BoardFigures, ...]
) -> None:
    usage = USAGE._replace(memory_mb=dict.fromkeys(USAGE.cpu_s, 80.0))
    figures = rate_figures(small_run.head, 1.0, boards, usage)
    assert not figures.kept_up
    assert math.isnan(figures.cores)
    document = figures.document()
    assert document["cpu_ms_per_frame"]["worker 0"] is None
    json.dumps(document, allow_nan=False)
    assert "nan" not in station_table([figures]) + process_table([figures])


def test_figures_of_one_board_without_a_result_fit_into_json(small_run: PrerenderedRun) -> None:
    slow = replace(BOARD, ready_after_last_frame_ms=math.inf, conclude_ms=math.inf)
    figures = rate_figures(small_run.head, 1.0, (slow,), USAGE)
    assert figures.ready_after_last_frame_ms == {"median": math.inf, "p99": math.inf, "max": math.inf}
    assert figures.document()["ready_after_last_frame_ms"]["p99"] is None


def test_board_of_one_row_has_no_lag_of_its_second_half() -> None:
    timeline = Timeline(frames_settled_s=(), tasks=(task(0, None, 0.1, 0.12),), last_frame_s=0.1, ready_s=0.2)
    counts = VerdictCounts.model_construct(ok=1, missing=0, incomplete=0)
    figures = board_figures(run_detail(1, timings(5.0), counts), timeline)
    assert figures.lag_first_half_ms == pytest.approx(20.0)
    assert math.isnan(figures.lag_second_half_ms)


@pytest.fixture(scope="module")
def figures(small_run: PrerenderedRun, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RateFigures]:
    folder = tmp_path_factory.mktemp("station")
    yield measure_station_pace(small_run, RATE, BOARDS, 2, folder, folder)
    assert not list(folder.glob("*.ring")), "the ring is removed with the station"


def test_running_station_stitches_all_boards(figures: RateFigures) -> None:
    assert len(figures.each) == BOARDS
    for board in figures.each:
        assert (board.status, board.frames, board.lost) == ("ok", 12, 0)
        assert 0 < board.conclude_ms < board.ready_after_last_frame_ms
        assert board.lag_first_half_ms > 0
    assert figures.statuses == {"ok": BOARDS}
    assert figures.frames_lost == 0
    assert math.isfinite(figures.lag_second_half_ms)


def test_frame_and_data_rate_are_those_of_the_line(figures: RateFigures, scenario: Scenario) -> None:
    assert figures.frames_per_s == pytest.approx(RATE / scenario.line.period_s, abs=0.01)
    assert figures.mbit_per_s == pytest.approx(2 * 640 * 480 * 8 * figures.frames_per_s / 1e6, rel=0.01)


def test_each_process_of_the_station_is_measured(figures: RateFigures) -> None:
    names = {"station", "sender", "acquisition", "fork server", "worker 0", "worker 1"}
    assert figures.cpu_ms_per_frame.keys() == figures.memory_mb.keys() == names
    assert all(mb > 1 for mb in figures.memory_mb.values())
