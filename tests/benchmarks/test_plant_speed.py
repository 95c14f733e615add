"""Figures of the cluster: ratios of one call, and what is counted of each outcome."""

from __future__ import annotations

import gzip
import json
from pathlib import Path

from vaoi_station.benchmarks.plant_speed import PlantFigures, _Outcomes, _tenths
from vaoi_station.plant.restitch import Terms
from vaoi_station.plant.restitch.task import FORMAT, VERSION, RunTask


def test_ratios_are_of_one_call() -> None:
    figures = PlantFigures(
        100, 95.0, 100.0, 50.0, (0.9, 0.95), (0.02, 0.034), 3100.0, 2.3, 1.0, 1.0, (300.0, 301.0), 9, 0, 0
    )
    found = figures.document()
    assert found["two_against_one"] == 2
    assert found["overhead"] == 0.0526
    assert found["rss_mb"] == [300, 301]
    table = "\n".join(figures.lines())
    assert "| by one worker | 100.0 s: +5.3 % | at most +5 % |" in table
    assert "| by two workers | 50.0 s: 2.00 times as fast | at least 1.8 times |" in table
    assert "| CPU per run: in one worker, in one of two | 0.90, 0.95 s | |" in table
    assert "beside one worker, two | 2, 3 % | |" in table
    assert "runs lost, twice | 0, 0 | 0, 0 |" in table
    assert "over 200 runs: second tenth, last tenth | 300, 301 MB: +0.3 % | flat |" in table


def test_outcomes_are_counted_by_run_and_process(tmp_path: Path) -> None:
    outcomes = _Outcomes(tmp_path)
    for process, key in ((1, "a"), (2, "b"), (1, "b")):
        document = {"format": FORMAT, "version": VERSION, "cost": {"process": process, "rss_mb": 300.0, "cpu_s": 0.5}}
        outcomes.keep(RunTask("x", key, "0" * 64, Terms("s")), gzip.compress(json.dumps(document).encode()))
    assert outcomes.keys == {"a": 1, "b": 2}
    assert outcomes.rss_mb == {1: [300, 300], 2: [300]}


def test_the_first_tenth_is_not_counted() -> None:
    assert _tenths([500.0] * 2 + [300.0] * 16 + [302.0] * 2) == (300.0, 302.0)
