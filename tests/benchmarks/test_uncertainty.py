"""Runs with errors drawn from known distributions."""

from __future__ import annotations

from pathlib import Path

import numpy as np
import pytest

from vaoi_station.benchmarks.uncertainty import (
    RunErrors,
    recorded_runs,
    recordings_with_truth,
    summarise_runs,
    twin_runs,
)
from vaoi_station.errors import InputError
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.simulation.recording_writer import write_passage


def normal_errors(seed: int, real_px: float, predicted_px: float, views: int = 4000) -> RunErrors:
    """Return a run whose real and predicted standard deviations are given; along y both are doubled."""
    g = np.random.default_rng(seed)
    covariance = np.tile(np.diag([predicted_px**2, 4 * predicted_px**2]), (views, 1, 1))
    error = g.normal(0, 1, (views, 2)) * (real_px, 2 * real_px)
    return RunErrors("normal", "ok", error, covariance, np.zeros(0), np.zeros(0))


def without_cad_matrix() -> RunErrors:
    """Return a run whose CAD matrix was not found."""
    return RunErrors("lost", "failed", np.zeros((0, 2)), np.zeros((0, 2, 2)), np.zeros(0), np.zeros(0))


@pytest.fixture(scope="module")
def progress() -> list[str]:
    return []


@pytest.fixture(scope="module")
def runs(progress: list[str]) -> list[RunErrors]:
    return list(twin_runs(6, first_seed=2000, report=progress.append))


@pytest.mark.parametrize(("real", "normalised"), [(0.01, 1.0), (0.02, 4.0), (0.005, 0.25)])
def test_measure_is_one_if_the_covariance_is_that_of_the_errors(real: float, normalised: float) -> None:
    run = normal_errors(1, real, predicted_px=0.01)
    assert run.normalised == pytest.approx(normalised, rel=0.05)
    assert run.rms_px == pytest.approx(run.predicted_rms_px * np.sqrt(normalised), rel=0.03)
    figures = summarise_runs([run, normal_errors(2, 0.01, 0.01)])
    assert figures.normalised_mean == pytest.approx((normalised + 1) / 2, rel=0.05)
    if normalised == 1:
        assert figures.beyond_three == pytest.approx(np.exp(-4.5), abs=0.004)


def test_runs_without_cad_matrix_count_as_failed_only() -> None:
    good = normal_errors(1, 0.01, 0.01)
    alone, beside = summarise_runs([good]), summarise_runs([without_cad_matrix(), good])
    assert (beside.runs, beside.failed) == (1, 1)
    assert beside.normalised_mean == alone.normalised_mean
    assert "no C" in without_cad_matrix().summary
    with pytest.raises(InputError, match="none of 2 boards has a CAD mapping"):
        summarise_runs([without_cad_matrix()] * 2)


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
