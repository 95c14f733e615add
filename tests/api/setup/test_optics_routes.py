"""The optics of a line over REST: what is known of it, and a plan."""

from __future__ import annotations

import json
from typing import Any

from typer.testing import CliRunner

from vaoi_station.api.access import scope_needed
from vaoi_station.api.setup.station_files import StationFiles
from vaoi_station.cli import app

PLAN = "/api/v1/optics/plan"
REQUIREMENTS = "/api/v1/optics/requirements"


def test_the_plan_is_that_of_the_command(client: Any) -> None:
    paper = client.get(REQUIREMENTS, params={"of": "paper"}).json()
    assert set(paper["sources"].values()) == {"paper"}
    found = client.get(PLAN, params=paper["values"]).json()
    printed = json.loads(CliRunner().invoke(app, ["plan", "--example", "paper", "--json"]).stdout)
    printed.pop("paper")
    assert found == _without_none(printed)
    assert {r["requirement"] for r in found["remedies"]} >= {"cameras", "frame_rate_hz"}


def test_what_the_station_knows_begins_a_plan(client: Any, files: StationFiles) -> None:
    known = client.get(REQUIREMENTS).json()
    assert known["values"].keys() == known["sources"].keys()
    missing = client.get(PLAN, params=known["values"])
    wheres = {fault["where"] for fault in missing.json()["errors"]}
    assert (missing.status_code, wheres) == (422, {"query.sensor_width_mm", "query.distance_max_mm"})
    whole = client.get(PLAN, params=known["values"] | {"sensor_width_mm": 6.4, "distance_max_mm": 500})
    assert (whole.status_code, whole.json()["array"]["camera_pitch_mm"]) == (200, 36.0)
    # A calibration that cannot be read is no reason to state nothing.
    files.config.calibration.write_text("{}")
    assert client.get(REQUIREMENTS).json()["sources"]["resolution_px_per_mm"] == "cameras.nominal_px_per_mm"


def test_contradictions_and_limits_are_refused_by_name(client: Any) -> None:
    paper = client.get(REQUIREMENTS, params={"of": "paper"}).json()["values"]
    for change in ({"distance_min_mm": 900}, {"width_mm": 1e9}, {"speed_mm_s": "nan"}, {"cameras": 1.5}):
        refused = client.get(PLAN, params=paper | change)
        assert (refused.status_code, next(iter(change)) in refused.json()["detail"]) == (422, True), refused.text
    assert client.get(PLAN, params=paper | {"breadth_mm": 3}).json()["code"] == "unknown-parameter"


def test_reading_is_enough() -> None:
    assert {scope_needed("GET", path) for path in (PLAN, REQUIREMENTS)} == {"read"}


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(v) for key, v in value.items() if v is not None}
    return [_without_none(v) for v in value] if isinstance(value, list) else value
