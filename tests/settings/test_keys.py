"""The keys of station.toml as the configuration model describes them."""

from __future__ import annotations

import re
from pathlib import Path

from vaoi_station.config import CameraConfig, StationConfig
from vaoi_station.settings.keys import documentation, keys, unit_of

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
    width = BY_KEY["cameras[].width"]
    assert (width.kind, width.required, width.limits) == ("integer", True, {"minimum": 16, "maximum": 65536})
    assert (BY_KEY["line.tail_s"].unit, BY_KEY["line.tail_s"].limits) == ("s", {"minimum": 0})
    assert (BY_KEY["ring.runs"].default, BY_KEY["ring.runs"].optional_table) == (3, False)
    assert BY_KEY["method"].choices == ("auto", "fiducials", "features", "reference")
    assert BY_KEY["line.expected_board.rotation_deg"].choices == ("0", "90", "180", "270")
    assert (BY_KEY["archive.url"].optional_table, BY_KEY["archive.url"].required) == (True, True)
    kinds = {
        key: BY_KEY[key].kind for key in ("calibration", "api.open_loopback", "cameras[].features", "controller.order")
    }
    assert list(kinds.values()) == ["path", "truth", "map", "list"]
    assert BY_KEY["controller.lights.NAME.on_us"].table == "controller.lights.NAME"


def test_texts_are_for_readers_of_the_file_not_of_the_source() -> None:
    assert BY_KEY["cameras[].packet_bytes"].description.startswith("Largest packet in bytes; empty for the MTU")
    assert BY_KEY["push.mqtt.port"].description.startswith("Empty: 8883")
    assert not [key.key for key in keys() if "`" in key.description or "None" in key.description]


def test_units_are_read_from_the_ends_of_names() -> None:
    found = {
        name: unit_of(name)
        for name in ("speed_mm_s", "mb_s", "keep_s", "days", "counts_per_mm", "px_per_mm", "workers")
    }
    assert list(found.values()) == ["mm/s", "MB/s", "s", "days", "1/mm", "px/mm", ""]


def test_the_documentation_of_a_model_includes_that_of_its_bases() -> None:
    class Inherited(CameraConfig):
        """A model of its own."""

    assert documentation(Inherited).keys() >= {"width", "gain_db"}
