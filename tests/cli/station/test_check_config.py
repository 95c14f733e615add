"""`vaoi check-config` prints all problems and ends with the exit code of the worst."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tests.cli.conftest import Result
from vaoi_station.demo.station_files import write_station_files
from vaoi_station.simulation import scenario_path


def test_exit_code_and_text(vaoi: Callable[..., Result], tmp_path: Path) -> None:
    path, _ = write_station_files(scenario_path("small"), tmp_path)
    (tmp_path / "data").mkdir()
    done = vaoi("check-config", path)
    assert (done.code, done.err) in {(0, ""), (1, "")}  # 1 where the machine has little space left
    path.write_text(path.read_text().replace("[line]", "colour = 1\n[line]\ntint = 2"))
    done = vaoi("check-config", path)
    assert done.code == 2
    assert "colour: is an unknown key" in done.out
    assert "line.tint: is an unknown key" in done.out
    assert "2 faults" in done.out
