"""Check the wall clock and the monotonic clock."""

from __future__ import annotations

from pathlib import Path

import pytest

from tests.doctor.conftest import assert_problem, only
from vaoi_station.doctor.checks import machine_clocks
from vaoi_station.doctor.finding import Level
from vaoi_station.doctor.machine import Machine


def test_wall_clock() -> None:
    figures = {"synchronised": True, "max_error_ms": 1.5}
    assert machine_clocks.judge_wall_clock(0, 1500).figures == figures
    unsynchronised = machine_clocks.judge_wall_clock(machine_clocks.TIME_ERROR, 16_000_000)
    assert_problem(unsynchronised, Level.WARNING, "is not synchronised")
    assert machine_clocks.judge_wall_clock(-1, 0).level is Level.NOT_APPLICABLE


def test_wall_clock_of_this_machine_is_read_without_privileges() -> None:
    assert only(machine_clocks.wall_clock(Machine())).level is not Level.FAULT


@pytest.mark.parametrize(
    ("resolution_s", "source", "words"),
    [(4e-3, "tsc", "4000 µs"), (1e-9, "hpet", "hpet"), (1e-9, "acpi_pm", "acpi_pm")],
)
def test_coarse_or_slow_monotonic_clock_is_a_warning(resolution_s: float, source: str, words: str) -> None:
    assert_problem(machine_clocks.judge_monotonic(resolution_s, source), Level.WARNING, words)


@pytest.mark.parametrize("source", ["tsc", "arch_sys_counter", None])
def test_fine_monotonic_clock_is_ok(source: str | None) -> None:
    assert machine_clocks.judge_monotonic(1e-9, source).level is Level.OK


def test_source_of_the_monotonic_clock_is_read_from_the_kernel(tmp_path: Path) -> None:
    directory = tmp_path / "sys/devices/system/clocksource/clocksource0"
    directory.mkdir(parents=True)
    (directory / "current_clocksource").write_text("acpi_pm\n")
    assert_problem(only(machine_clocks.monotonic_clock(Machine(tmp_path))), Level.WARNING, "acpi_pm")
