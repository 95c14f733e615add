"""`vaoi backup` and `vaoi restore` on a station of the twin."""

from __future__ import annotations

from collections.abc import Callable
from pathlib import Path

from tests.cli.conftest import Result
from vaoi_station.config import read_config
from vaoi_station.demo.station_files import write_station_files
from vaoi_station.simulation import read_scenario, scenario_path
from vaoi_station.store import Database


def test_a_station_is_backed_up_and_restored(vaoi: Callable[..., Result], tmp_path: Path) -> None:
    path, _ = write_station_files(scenario_path("small"), tmp_path / "a")
    with path.open("a") as file:
        file.write('\n[api]\ncertificate = "station.toml"\nprivate_key = "station.key"\n')
    config = read_config(path)
    backup = tmp_path / "station.backup"
    refused = vaoi("backup", backup, "--config", path)
    assert refused.code == 2
    assert "does not exist" in refused.err
    Database(config.data / "station.db").close()
    made = vaoi("backup", backup, "--config", path, "--recordings")
    assert made.code == 0
    assert f"{backup}: " in made.out
    assert vaoi("restore", backup, "--config", path).code == 2, "a station is there"
    restored = vaoi("restore", backup, "--config", tmp_path / "b" / "station.toml")
    assert restored.code == 2, "the paths of this station.toml are absolute"
    moved = tmp_path / "old"
    (tmp_path / "a").rename(moved)
    done = vaoi("restore", backup, "--config", path)
    assert done.code == 0
    assert f"not in the backup, put it back: {tmp_path / 'a' / 'station.key'} (api.private_key)" in done.out
    again = read_config(path)
    assert again == config
    assert again.simulation is not None
    assert read_scenario(again.simulation.scenario)
    assert (again.data / "station.db").is_file()
