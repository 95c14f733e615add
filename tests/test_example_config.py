"""The example station.toml and its page: they fit the shipped scenario and say every key."""

from __future__ import annotations

from pathlib import Path

from pydantic import BaseModel

from vaoi_station.acquisition.backends import check_backends
from vaoi_station.config import StationConfig, read_config
from vaoi_station.simulation import scenario_path

ROOT = Path(__file__).resolve().parents[1]


def test_the_example_is_a_station_of_the_shipped_scenario() -> None:
    config = read_config(ROOT / "deploy" / "station.toml")
    assert config.simulation is not None
    shipped = config.simulation.model_copy(update={"scenario": scenario_path("demo")})
    check_backends(config.model_copy(update={"simulation": shipped}))


def keys_of(model: type[BaseModel]) -> set[str]:
    keys: set[str] = set()
    for name, field in model.model_fields.items():
        keys.add(name)
        for part in (field.annotation, *getattr(field.annotation, "__args__", ())):
            if isinstance(part, type) and issubclass(part, BaseModel):
                keys |= keys_of(part)
    return keys


def test_the_page_says_every_key() -> None:
    page = (ROOT / "docs" / "configuration.md").read_text()
    assert [key for key in keys_of(StationConfig) if key not in page] == []
