"""Figures of callers of the REST interface: their computation, and one small station that serves them."""

from __future__ import annotations

import json
import math

import pytest

from vaoi_station.benchmarks.station.prerendered_run import PrerenderedRun
from vaoi_station.benchmarks.station.rest_pace import (
    LARGE_CALLERS,
    LARGE_PX_PER_MM,
    RestFigures,
    measure_rest,
    picture_paths,
    reply_times,
)
from vaoi_station.runs.states.schemas import ComponentSummary


def test_percentiles_are_measured_values() -> None:
    times = reply_times([*range(1, 201), 1000])
    assert (times.count, times.p50_ms, times.p99_ms, times.max_ms) == (201, 101, 199, 1000)


def test_no_reply_has_no_time() -> None:
    assert math.isnan(reply_times([]).p99_ms)


def test_every_seen_component_has_a_picture_and_the_largest_ones_have_large_pictures(small_run: PrerenderedRun) -> None:
    board = small_run.board_type
    seen = [_summary(c.address, views=n) for n, c in enumerate(board.components)]
    small, large = picture_paths("/runs/r1", seen, board)
    assert small == [f"/runs/r1/components/{c.address}/images/0" for c in board.components[1:]]
    area = {c.address: c.width * c.height for c in board.components}
    areas = [area[path.split("/")[4]] for path in large]
    assert areas == sorted(areas, reverse=True)
    assert 0 < len(large) <= LARGE_CALLERS
    assert all(path.endswith(f"/images/0?px_per_mm={LARGE_PX_PER_MM}") for path in large)


def _summary(address: str, views: int) -> ComponentSummary:
    return ComponentSummary(
        address=address, ref=address, panel=None, center_mm=(0, 0), width_mm=1, height_mm=1, rotation_deg=0,
        tester_mm=None, views=views,
    )  # fmt: skip


@pytest.fixture(scope="module")
def figures(small_run: PrerenderedRun, tmp_path_factory: pytest.TempPathFactory) -> RestFigures:
    folder = tmp_path_factory.mktemp("rest")
    return measure_rest(small_run, 2, folder, folder)


def test_pictures_are_fetched_while_boards_are_filmed_and_while_not(figures: RestFigures) -> None:
    assert figures.picture.count > 0
    assert figures.idle.count > 0
    assert "(goal 4 ms, 15 ms)" in figures.lines()[2]
    assert figures.trivial.count > 0
    assert figures.idle_trivial.cpu_ms > 0
    assert figures.idle.cpu_ms > 0
    assert 0 < figures.picture.p50_ms <= figures.picture.p99_ms <= figures.picture.max_ms
    assert all(0 < ms < math.inf for ms in figures.ready_ms.values())
    assert len(figures.ready_ms) == 3


def test_all_pictures_of_a_run_are_read_four_times(figures: RestFigures) -> None:
    raw, again, jpeg, _ = figures.batches
    assert all(batch.complete for batch in figures.batches)
    assert raw.mbytes == again.mbytes > jpeg.mbytes
    processes = {"station", "acquisition", "fork server", "worker 0", "worker 1"}
    assert raw.memory_mb.keys() == figures.memory_before_mb.keys() == processes


def test_figures_fit_into_json_and_lines(figures: RestFigures) -> None:
    json.dumps(figures.document(), allow_nan=False)
    assert [line.split()[0] for line in figures.lines()] == [
        "pictures", "trivial", "pictures", "trivial", "large", *["matrices"] * 3, *["batch"] * 4, "load",
    ]  # fmt: skip
