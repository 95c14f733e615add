"""Figures of a station's boards: kept when a run ends and when it is checked, returned whole, thinned and compared."""

from __future__ import annotations

import json
import sqlite3
import tracemalloc
from collections.abc import Callable
from datetime import UTC, datetime, timedelta
from typing import Any
from unittest.mock import Mock

import numpy as np
import pytest

from vaoi_station.acquisition.process.messages import Grant
from vaoi_station.errors import StateError
from vaoi_station.runs.trends.trends import (
    TrendHistory,
)
from vaoi_station.stitching.quality.verdict import sigma_limit_px
from vaoi_station.store import Store
from vaoi_station.store.figures import BoardRow, Span

EVER = Span("2000-01-01T00:00:00.000Z", "2100-01-01T00:00:00.000Z")
YEAR = Span("2026-01-01T00:00:00.000Z", "2027-01-01T00:00:00.000Z")


def test_figures_outlive_their_run(make_rig: Callable[..., Any], store: Store) -> None:
    rig = make_rig()
    rig.ready()
    grant = rig.arm()
    rig.board(grant)
    rig.result_of(grant.run)
    trends = rig.coordinator.kept.trends
    shown = rig.coordinator.kept.all_shown

    def figures() -> set[str]:
        return {series.figure for series in trends.trends(EVER, (), 100).series}

    rig.wait_for(lambda: {"lost_frames", "drift_px"} <= figures(), "the figures of run and check")
    assert shown(rig.coordinator.runs())[0].figures is None
    of_run = shown(rig.coordinator.runs(), True)[0].figures
    assert of_run["lost_frames"] == 0
    assert {name.partition(":")[0] for name in of_run} == figures()
    store.retention.forget_details([grant.run]).result(10)
    store.database.write(lambda c: c.execute("DELETE FROM calibration_checks")).result(10)
    store.retention.forget_runs([grant.run]).result(10)
    found = trends.trends(EVER, (), 100)
    assert (found.boards, found.runs, found.bin_s) == (1, (grant.run,), None)
    assert {"lost_frames", "drift_px"} <= figures()


def test_the_first_board_after_a_restart_is_marked(
    make_rig: Callable[..., Any], store: Store, monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make_rig()
    rig.ready()
    grant = rig.arm()
    rig.board(grant)
    run = rig.result_of(grant.run)
    for start in ("2027-01-01T00:00:00.000Z", "2027-01-02T00:00:00.000Z"):
        monkeypatch.setattr("vaoi_station.runs.trends.trends.utc", lambda at=start: at)
        history = TrendHistory(store.figures, ("a",), 16)  # that of a start of the station
        for number in range(2):
            history.finished(run.model_copy(update={"id": f"{start}-{number}", "started": start}), lambda _: None)
    store.database.write(lambda _: None).result(10)
    marks = [mark for mark in history.trends(EVER, (), 100).marks if mark.kind == "restart"]
    assert [mark.run for mark in marks] == ["2027-01-01T00:00:00.000Z-0", "2027-01-02T00:00:00.000Z-0"]
    assert (marks[1].before, marks[1].after) == ("2027-01-01T00:00:00.000Z", "2027-01-02T00:00:00.000Z")


def test_figures_that_cannot_be_kept_hold_up_no_result(
    make_rig: Callable[..., Any], monkeypatch: pytest.MonkeyPatch
) -> None:
    rig = make_rig()
    rig.ready()
    grant = rig.arm()
    for fault in (StateError("The database is closed."), ValueError("a fault")):
        monkeypatch.setattr(rig.archive.figures, "add", Mock(side_effect=fault))
        rig.board(grant)
        assert rig.result_of(grant.run).verdict == "ok"
        grant = rig.peer.expect(Grant)


def test_the_line_of_uncertainty_has_the_limit_of_a_coarse_station(store: Store) -> None:
    history = TrendHistory(store.figures, ("a",), 16)
    store.figures.add(BoardRow("r1", "2026-01-01T00:00:00.000Z", "b", {"sigma_px": 0.22}), {}, 10)
    store.database.write(lambda _: None).result(10)
    history.sigma_limit_px = sigma_limit_px(4.0)
    [line] = history.trends(EVER, (), 100).series
    assert line.figure == "sigma_px"
    assert line.upper == pytest.approx(0.24)


@pytest.mark.parametrize("what", ["boards", "hours", "comparison"])
def test_memory_does_not_grow_with_the_boards_that_are_read(store: Store, what: str) -> None:
    figures = {f"seam_px:{n}-{n + 1}": n / 8 for n in range(40)}
    document, hour = json.dumps(figures), json.dumps({k: (9, v, v, v, "r0") for k, v in figures.items()})
    begin = datetime(2026, 1, 1, tzinfo=UTC)
    hours = [((begin + timedelta(hours=n)).isoformat()[:13], hour) for n in range(1200)]

    def write(connection: sqlite3.Connection) -> None:
        rows = [(f"r{n:04d}", f"{hours[n // 5][0]}:{n % 5:02d}:00.000Z", document) for n in range(1200)]
        connection.executemany("INSERT INTO board_figures VALUES (?, ?, 'b', ?)", rows if what != "hours" else ())
        connection.executemany("INSERT INTO hourly_figures (hour, board_type, document) VALUES (?, 'b', ?)", hours)

    store.database.write(write).result(10)
    history, now = TrendHistory(store.figures, ("a",), 16), Span(hours[120][0], "2027")
    tracemalloc.start()
    if what == "comparison":
        assert history.compared(Span("2025", now.since), now).boards == 600
    else:
        assert history.trends(YEAR, (), 10).boards == {"boards": 1200, "hours": 10_800}[what]
    peak = tracemalloc.get_traced_memory()[1]
    tracemalloc.stop()
    # Parsed, 1200 boards of 40 figures take 7 MB, as many hours 20 MB.
    assert peak < 2.5e6


def boards(count: int, seed: int, **means: float) -> list[BoardRow]:
    random = np.random.default_rng(seed)
    columns = {name: mean + 0.1 * abs(mean) * random.standard_normal(count) for name, mean in means.items()}
    return [BoardRow(f"r{n}", "", "b", {k: float(v[n]) for k, v in columns.items()}) for n in range(count)]
