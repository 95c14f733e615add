"""CPU time and memory over the length of the board."""

from __future__ import annotations

import pytest

from vaoi_station.benchmarks.growth import ScalingFigures, measure_scaling
from vaoi_station.simulation import Scenario


@pytest.fixture(scope="module")
def steps() -> list[str]:
    return []


@pytest.fixture(scope="module")
def figures(scenario: Scenario, steps: list[str], tmp_path_factory: pytest.TempPathFactory) -> list[ScalingFigures]:
    return measure_scaling(scenario, tmp_path_factory.mktemp("scaling"), (4, 7), steps.append)


def test_boards_are_stitched_and_grow_with_their_rows(figures: list[ScalingFigures], steps: list[str]) -> None:
    assert [(f.frames, f.rows, f.status) for f in figures] == [(12, 4, "ok"), (21, 7, "ok")]
    assert figures[1].board_mm[1] > figures[0].board_mm[1]
    assert len(steps) == 2, "one step per board"
    assert all(f.links_ms_per_frame > 0 and f.conclude_ms_per_frame > 0 and f.own_memory_mb >= 0 for f in figures)
