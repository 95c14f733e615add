"""A recording of a board of the twin on disk, and its stitched run."""

from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.reporting import StitchedRun, restitch
from vaoi_station.simulation import Twin, read_scenario, scenario_path
from vaoi_station.simulation.recording_writer import write_passage
from vaoi_station.stitching.recordings.opening import open_run


@pytest.fixture(scope="session")
def run(tmp_path_factory: pytest.TempPathFactory) -> Path:
    """A run without faults; tests read it and do not change it."""
    out = tmp_path_factory.mktemp("reporting") / "run <1> & co"
    write_passage(Twin(read_scenario(scenario_path("small"))).passage(0), out, with_truth=True)
    return out


@pytest.fixture(scope="session")
def stitched(run: Path) -> StitchedRun:
    return restitch(open_run(run))
