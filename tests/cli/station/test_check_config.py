"""`vaoi check-config` prints all problems and ends with the exit code of the worst."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

import pytest

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


@pytest.mark.parametrize("encoding", ["utf-8-sig", "utf-16"])
def test_files_with_byte_order_marks_are_no_problem(vaoi: Callable[..., Result], tmp_path: Path, encoding: str) -> None:
    path, _ = write_station_files(scenario_path("small"), tmp_path)
    (tmp_path / "data").mkdir()
    plain = vaoi("check-config", path)
    for file in (path, *tmp_path.rglob("*.json"), *tmp_path.rglob("scenario.toml")):
        file.write_bytes(file.read_text().encode(encoding))
    assert vaoi("check-config", path) == plain


def test_a_configuration_in_utf_16_without_a_mark_is_a_fault_with_an_action(
    vaoi: Callable[..., Result], tmp_path: Path
) -> None:
    path, _ = write_station_files(scenario_path("small"), tmp_path)
    path.write_bytes(path.read_text().encode("utf-16-le"))
    done = vaoi("check-config", path)
    assert (done.code, "station.toml: has a zero character" in done.out, "Save it as UTF-8" in done.out) == (
        2,
        True,
        True,
    ), done
