"""The optics of a line over REST: what is known of it, and a plan."""

from __future__ import annotations

import json
from typing import Any

import pytest
from typer.testing import CliRunner

from tests.api.held.setup_files import PITCH_MM
from tests.api.held_station import CAMERAS, HEIGHT, PX_PER_MM, WIDTH
from vaoi_station.api.setup.optics import known_requirements
from vaoi_station.api.setup.station_files import StationFiles
from vaoi_station.cli import app
from vaoi_station.files import read_calibration

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


def _without_none(value: Any) -> Any:
    if isinstance(value, dict):
        return {key: _without_none(v) for key, v in value.items() if v is not None}
    return [_without_none(v) for v in value] if isinstance(value, list) else value


COVERED_MM = (CAMERAS - 1) * PITCH_MM + WIDTH / PX_PER_MM


def test_the_calibration_states_resolution_and_width(files: StationFiles) -> None:
    calibration = read_calibration(files.config.calibration)
    known = known_requirements(files.config, calibration)
    assert known["resolution_px_per_mm"] == (PX_PER_MM, "calibration")
    assert known["width_mm"] == (COVERED_MM, "calibration")
    assert known["speed_mm_s"] == (100.0, "line.conveyor_mm_s")
    assert known["frame_rate_hz"] == (9.52381, "line.trigger_period_s")
    assert known["cameras"] == (float(CAMERAS), "cameras")
    assert "distance_max_mm" not in known
    far = calibration.model_copy(update={"working_distance_mm": 480.0})
    assert known_requirements(files.config, far)["distance_max_mm"] == (480.0, "calibration")


@pytest.mark.parametrize(("roll_deg", "px_h"), [(0.0, WIDTH), (178.0, WIDTH), (90.0, HEIGHT), (-90.0, HEIGHT)])
def test_the_mounting_of_a_camera_decides_which_side_lies_across_the_motion(
    files: StationFiles, roll_deg: float, px_h: int
) -> None:
    turned = tuple(c.model_copy(update={"nominal_roll_deg": roll_deg}) for c in files.config.cameras)
    known = known_requirements(files.config.model_copy(update={"cameras": turned}), None)
    assert (known["sensor_px_h"][0], known["sensor_px_v"][0]) == (px_h, WIDTH + HEIGHT - px_h)
