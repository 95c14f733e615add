from __future__ import annotations

from pathlib import Path

import pytest
from pydantic import BaseModel

from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.simulation import Scenario, find_scenario, read_scenario, scenario_path
from vaoi_station.simulation.scenario import Section

DOC = Path(__file__).parents[2] / "docs" / "reference" / "twin.md"


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


def _tables(model: type[BaseModel], path: str) -> dict[str, type[BaseModel]]:
    found: dict[str, type[BaseModel]] = {}
    for name, field in model.model_fields.items():
        here = f"{path}.{name}" if path else name
        for part in (field.annotation, *getattr(field.annotation, "__args__", ())):
            for inner in (part, *getattr(part, "__args__", ())):
                if isinstance(inner, type) and issubclass(inner, Section):
                    listed = "[]" if "tuple" in str(field.annotation) else ""
                    key = f"{here}.NAME" if "dict" in str(field.annotation) else here + listed
                    found[key] = inner
                    found |= _tables(inner, key)
    return found


def test_every_key_is_documented() -> None:
    tables = _tables(Scenario, "")
    assert {"array", "board.fiducials[]", "lights.NAME", "faults.stuck[]"} <= set(tables)
    chapters = {c.splitlines()[0].strip("`[]").rstrip("`"): c for c in DOC.read_text().split("\n### ")[1:]}
    for table, model in tables.items():
        chapter = next(
            (c for title, c in chapters.items() if title.removesuffix("]") in (table, table.rstrip("[]"))), ""
        )
        keys = [k for k in model.model_fields if not any(t.startswith(f"{table}.{k}") for t in tables)]
        missing = [key for key in keys if f"\n| `{key}` |" not in chapter]
        assert not missing, f"docs/reference/twin.md: [{table}] lacks {missing}"
