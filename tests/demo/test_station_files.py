"""Write the files of a demo station and read them back."""

from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.config import ReplayConfig, RingConfig, StationConfig, read_config
from vaoi_station.demo import station_files
from vaoi_station.files import read_board_type, read_calibration
from vaoi_station.simulation import Twin, read_scenario, scenario_path


def test_written_files_describe_a_complete_station(tmp_path: Path) -> None:
    path, twin = station_files.write_station_files(scenario_path("small"), tmp_path, boards=1)
    config = read_config(path)
    assert config == station_files.station_config(twin, scenario_path("small"), tmp_path, 1)
    assert config.simulation is not None
    assert config.simulation.boards == 1
    assert [c.head for c in config.cameras] == list(twin.heads), "the page calibrates with the nominal values"
    assert read_calibration(config.calibration, len(config.cameras)).working_distance_mm == 300
    assert read_board_type(config.board_types / "small.json") == twin.board_type


@pytest.fixture(scope="module")
def twin() -> Twin:
    return Twin(read_scenario(scenario_path("small")))


def test_every_table_survives_a_round_trip_through_toml(twin: Twin, tmp_path: Path) -> None:
    plain = station_files.station_config(twin, scenario_path("small"), tmp_path, 0)
    full = plain.model_copy(
        update={
            "name": 'with "quotes", umlauts äöü and ∅',
            "replay": ReplayConfig(recordings=(tmp_path / "a b", tmp_path / "c"), pace="fast", pause_s=0.0),
            "ring": RingConfig(directory=tmp_path, runs=5, lease_s=1e-3),
        }
    )
    for config in (plain, full):
        (tmp_path / "station.toml").write_text(station_files.to_toml(config), encoding="utf-8")
        assert read_config(tmp_path / "station.toml") == StationConfig.model_validate(config.model_dump())
