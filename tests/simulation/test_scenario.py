from __future__ import annotations

from pathlib import Path

import pytest

from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.settings.keys import keys
from vaoi_station.simulation import Scenario, find_scenario, read_scenario, scenario_path


@pytest.mark.parametrize("name", ["demo", "light", "paper", "small"])
def test_shipped_scenarios_read(name: str) -> None:
    assert read_scenario(scenario_path(name)).board.name == name


def test_a_folder_does_not_hide_a_shipped_scenario_and_a_file_does(
    tmp_path: Path, monkeypatch: pytest.MonkeyPatch
) -> None:
    monkeypatch.chdir(tmp_path)
    (tmp_path / "small").mkdir()
    (tmp_path / "mine").mkdir()
    assert find_scenario("small") == scenario_path("small")
    with pytest.raises(NotFoundError, match="mine: is a folder, not a scenario file"):
        find_scenario("mine")
    with pytest.raises(NotFoundError, match="no scenario 'smal'"):
        find_scenario("smal")
    (tmp_path / "demo").write_text("[board]\nname = 'own'\n")
    assert find_scenario("demo") == tmp_path / "demo"
    assert find_scenario(tmp_path / "own.toml") == tmp_path / "own.toml"


@pytest.mark.parametrize(
    ("text", "message"),
    [
        ("[array]\ncamera = 3", "array.camera"),
        ("[belt]\nspeed_mm_s = -1.0", "belt.speed_mm_s.*greater than 0"),
        ("[belt]\ndirection = 2", "belt.direction"),
        ("[board]\nlift_mm = nan", "board.lift_mm"),
        ("[board]\nfiducials = [{x_mm = 200.0, y_mm = 1.0}]", "lies off the board"),
        ('[line]\nlights = ["dome"]', "dome.*ring"),
        ("[array]\nexposures_us = [200000.0]", "exposures_us has 200000"),
        ("[[faults.lost_frames]]\ncamera = 3\nrow = 0", "names camera 3"),
        ("[[faults.incomplete_frames]]\ncamera = 0\nrow = 0\nshare = 1.0", "share"),
    ],
)
def test_refusals_name_file_key_and_limit(tmp_path: Path, text: str, message: str) -> None:
    path = tmp_path / "bad.toml"
    path.write_text(text)
    with pytest.raises(InputError, match=message) as caught:
        read_scenario(path)
    assert "bad.toml" in str(caught.value)


def test_every_key_has_a_meaning() -> None:
    assert {"array", "board.fiducials[]", "lights.NAME", "faults.stuck[]"} <= {key.table for key in keys(Scenario)}
    assert [key.key for key in keys(Scenario) if not key.description] == []
