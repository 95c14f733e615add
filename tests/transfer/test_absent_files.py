"""Files that a station.toml names and that are not there."""

from __future__ import annotations

from pathlib import Path

from vaoi_station.config import read_config
from vaoi_station.demo.station_files import write_station_files
from vaoi_station.simulation import scenario_path
from vaoi_station.transfer.absent_files import absent_files


def test_every_table_and_list_is_searched(tmp_path: Path) -> None:
    path, _ = write_station_files(scenario_path("small"), tmp_path)
    config = read_config(path)
    (tmp_path / "station.pem").touch()
    with path.open("a") as file:
        file.write('\n[api]\ncertificate = "station.pem"\nprivate_key = "station.key"\n')
        file.write('\n[push.mqtt]\nhost = "broker"\nuser = "a"\npassword_file = "mqtt.password"\n')
    before = set(absent_files(config))
    assert set(absent_files(read_config(path))) - before == {
        ("api.private_key", tmp_path / "station.key"),
        ("push.mqtt.password_file", tmp_path / "mqtt.password"),
    }
