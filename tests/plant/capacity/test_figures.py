"""Rates, sizes and cost, checked by hand."""

from __future__ import annotations

import pytest

from vaoi_station.plant.capacity import Measured, Plant, figures


def test_figures_of_a_small_plant() -> None:
    measured = Measured(pixels_per_frame=1e6, frames_per_run=10, ratio=2, task_cpu_s=0.36, tables_kb=20, worker_mb=500)
    plant = Plant(stations=10, frames=1e6, boards_per_hour=36, hours_per_day=10, workers=2, core_hour=1, gb_month=0.1)
    found = figures(measured, plant)
    assert found.runs == 1e5
    assert found.boards_per_day == 3600
    assert found.kept_days == pytest.approx(27.8, abs=0.1)
    assert found.archive_tb == pytest.approx(0.5)  # 5 MB each
    assert found.data_set_gb == pytest.approx(2)
    assert found.station_mbit_s == pytest.approx(0.4)  # 5 MB in 100 s
    assert found.storage_mbit_s == pytest.approx(4)
    assert found.restitch_hours == pytest.approx(5)
    assert found.restitch_mbit_s == pytest.approx(5e5 * 8 / 18000)
    assert found.memory_gb == 1
    assert found.cost_restitch == pytest.approx(100)
    assert found.cost_month == pytest.approx(500)
