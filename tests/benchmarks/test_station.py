"""The whole station and its growth, on boards small enough for a test; what is measured is never judged."""

from __future__ import annotations

import math
from collections.abc import Iterator
from pathlib import Path

import numpy as np
import pytest

from vaoi_station.benchmarks.film import Film, film
from vaoi_station.benchmarks.growth import Growth, growth, long_board
from vaoi_station.benchmarks.paced import RateFigures, paced
from vaoi_station.benchmarks.tables import growth_table, shares_table, station_table
from vaoi_station.simulation import Scenario, Twin, read_scenario, scenario_path

BOARDS, RATE = 2, 2.0


@pytest.fixture(scope="module")
def scenario() -> Scenario:
    return read_scenario(scenario_path("small"))


@pytest.fixture(scope="module")
def small_film(scenario: Scenario, tmp_path_factory: pytest.TempPathFactory) -> Film:
    return film(scenario, tmp_path_factory.mktemp("film"))


@pytest.fixture(scope="module")
def figures(small_film: Film, tmp_path_factory: pytest.TempPathFactory) -> Iterator[RateFigures]:
    folder = tmp_path_factory.mktemp("station")
    yield paced(small_film, RATE, BOARDS, 2, folder, folder)
    assert not list(folder.glob("*.ring")), "the ring is gone with the station"


def test_a_film_shows_what_the_twin_shows(small_film: Film, scenario: Scenario) -> None:
    passage, frames = Twin(scenario).passage(0), small_film.map()
    assert frames.shape == (passage.rows, 2, 480, 640)
    for camera, row in ((0, 0), (1, 3)):
        assert np.array_equal(frames[row, camera], passage.frame(camera, row))
    assert small_film.head == passage.head()
    assert small_film.line == passage.twin.line


def test_a_film_is_rendered_once_and_again_for_another_scenario(scenario: Scenario, tmp_path: Path) -> None:
    told: list[str] = []
    film(scenario, tmp_path, told.append)
    film(scenario, tmp_path, told.append)
    assert len(told) == 2, "drawn and filmed once"
    other = scenario.model_copy(update={"belt": scenario.belt.model_copy(update={"seed": 99})})
    film(other, tmp_path, told.append)
    assert len(told) == 4


def test_every_board_is_filmed_and_stitched_by_the_station(figures: RateFigures) -> None:
    assert len(figures.each) == BOARDS
    for board in figures.each:
        assert (board.status, board.frames, board.lost) == ("ok", 12, 0)
        assert 0 < board.conclude_ms < board.ready_after_last_frame_ms
        assert board.lag_first_half_ms > 0
    assert figures.statuses == {"ok": BOARDS}
    assert figures.frames_lost == 0


def test_the_rate_is_the_lines(figures: RateFigures, scenario: Scenario) -> None:
    assert figures.frames_per_s == pytest.approx(RATE / scenario.line.period_s, abs=0.01)
    assert figures.mbit_per_s == pytest.approx(2 * 640 * 480 * 8 * figures.frames_per_s / 1e6, rel=0.01)


def test_time_and_memory_of_every_process_are_told_and_the_sender_counts_apart(figures: RateFigures) -> None:
    names = {"station", "sender", "acquisition", "worker 0", "worker 1"}
    assert figures.cpu_ms_per_frame.keys() == figures.memory_mb.keys() == names
    assert all(mb > 1 for mb in figures.memory_mb.values())
    filming_s = BOARDS * 6 / figures.frames_per_s
    mine = sum(ms for name, ms in figures.cpu_ms_per_frame.items() if name != "sender")
    assert figures.cores == pytest.approx(mine * 1e-3 * BOARDS * 12 / filming_s, rel=0.02)


def test_all_figures_are_finite_and_stand_in_the_tables(figures: RateFigures) -> None:
    numbers = [*figures.ready_after_last_frame_ms.values(), figures.lag_first_half_ms, figures.lag_second_half_ms]
    assert all(math.isfinite(n) for n in numbers)
    line = station_table([figures]).splitlines()[-1]
    assert line.startswith(f"| 2× | {figures.frames_per_s:.2f} |")
    assert "worker 1" in shares_table([figures])


@pytest.fixture(scope="module")
def grown(scenario: Scenario, tmp_path_factory: pytest.TempPathFactory) -> list[Growth]:
    return growth(scenario, tmp_path_factory.mktemp("growth"), (4, 7), lambda _: None)


def test_longer_boards_take_the_rows_they_are_made_for(grown: list[Growth], scenario: Scenario) -> None:
    assert [(g.frames, g.rows) for g in grown] == [(12, 4), (21, 7)]
    assert [Twin(long_board(scenario, n)).passage(0).rows for n in (4, 33, 333)] == [4, 33, 333]
    assert [g.status for g in grown] == ["ok", "ok"]
    assert grown[1].board_mm[1] > grown[0].board_mm[1]


def test_cost_and_memory_of_every_length_are_told(grown: list[Growth]) -> None:
    for g in grown:
        assert g.links_ms_per_frame > 0
        assert g.conclude_ms_per_frame > 0
        assert g.own_memory_mb >= 0
        assert g.frames_mb == pytest.approx(g.frames * 640 * 480 / 1e6, rel=0.02)
    assert growth_table(grown).count("\n") == 3
