"""Runs with errors drawn from known distributions."""

from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.benchmarks.uncertainty import (
    RunErrors,
    recorded_runs,
    recordings_with_truth,
    summarise_runs,
    twin_runs,
)
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.simulation.recording_writer import write_passage


@pytest.fixture(scope="module")
def progress() -> list[str]:
    return []


@pytest.fixture(scope="module")
def runs(progress: list[str]) -> list[RunErrors]:
    return list(twin_runs(6, first_seed=2000, report=progress.append))


def test_predicted_and_real_errors_of_the_twin_agree(runs: list[RunErrors], progress: list[str]) -> None:
    """The mean of six runs scatters by about a third around that of thirty."""
    figures = summarise_runs(runs)
    print(figures)
    assert figures.failed == 0
    assert 0.4 < figures.normalised_mean < 2.0
    assert figures.worst < 6
    assert figures.surface_normalised is not None
    assert 0.2 < figures.surface_normalised < 4.0
    assert max(r.rms_px for r in runs) < 0.05
    assert [line.split()[1] for line in progress] == [str(seed) for seed in range(2000, 2006)]


def test_recordings_are_compared_with_their_truth_files(tmp_path: Path) -> None:
    passage = Twin(read_scenario(scenario_path("small"))).passage(0)
    write_passage(passage, tmp_path / "b")
    write_passage(passage, tmp_path / "a")
    (tmp_path / "a" / "board.json").unlink()
    found = recordings_with_truth(tmp_path)
    assert found == [tmp_path / "b"], "without a board type there is nothing to compare"
    (run,) = recorded_runs(found, print)
    assert (run.name, run.status) == ("b", "ok")
    assert len(run.surface_error_mm) == 0
    assert run.rms_px < 0.05
