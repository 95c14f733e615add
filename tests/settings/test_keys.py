"""The keys of station.toml as the configuration model describes them."""

from __future__ import annotations

import re
from pathlib import Path

from vaoi_station.config import StationConfig
from vaoi_station.settings.keys import keys

ROOT = Path(__file__).resolve().parents[2]
GERMAN = ROOT / "vaoi_station" / "api" / "web" / "texts" / "de.js"
BY_KEY = {key.key: key for key in keys()}


def test_every_key_is_documented_in_the_model() -> None:
    assert [key.key for key in keys() if not key.description] == []
    assert {key.key.split(".")[0].removesuffix("[]") for key in keys()} == set(StationConfig.model_fields)


def test_the_german_page_has_a_text_for_every_key() -> None:
    (meanings,) = re.findall(r"^  meanings: {\n(.*?)^  }", GERMAN.read_text(encoding="utf-8"), re.MULTILINE | re.DOTALL)
    said = re.findall(r'^    "([^"]+)": "', meanings, re.MULTILINE)
    assert sorted(said) == sorted(BY_KEY)


def test_kind_limits_units_and_defaults_are_those_of_the_model() -> None:
    width, tail = BY_KEY["cameras[].width"], BY_KEY["line.tail_s"]
    assert (width.kind, width.required, width.minimum, width.maximum) == ("integer", True, 16, 65536)
    assert (tail.unit, tail.minimum, tail.maximum) == ("s", 0, None)
    assert (BY_KEY["ring.runs"].default, BY_KEY["ring.runs"].optional_table) == ("3", False)
    assert BY_KEY["method"].choices == ["auto", "fiducials", "features", "reference"]
    assert BY_KEY["line.expected_board.rotation_deg"].choices == ["0", "90", "180", "270"]
    assert (BY_KEY["archive.url"].optional_table, BY_KEY["archive.url"].required) == (True, True)
    kinds = {
        key: BY_KEY[key].kind for key in ("calibration", "api.open_loopback", "cameras[].features", "controller.order")
    }
    assert list(kinds.values()) == ["path", "truth", "map", "list"]
    assert BY_KEY["controller.lights.NAME.on_us"].table == "controller.lights.NAME"
