"""What a plan of the optics can take from station.toml and the calibration."""

from __future__ import annotations

from typing import Any

import pytest

from tests.api.held.setup_files import PITCH_MM
from tests.api.held_station import CAMERAS, HEIGHT, PX_PER_MM, WIDTH
from vaoi_station.api.setup.known_requirements import known_requirements
from vaoi_station.api.setup.station_files import StationFiles
from vaoi_station.config import LightConfig
from vaoi_station.files import read_calibration

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


def test_without_a_calibration_nominal_values_are_taken(files: StationFiles) -> None:
    known = known_requirements(files.config, None)
    assert known["width_mm"] == (COVERED_MM, "cameras.nominal_center_mm")
    assert known["resolution_px_per_mm"] == (PX_PER_MM, "cameras.nominal_px_per_mm")
    bare = (files.config.cameras[0].model_copy(update={"nominal_px_per_mm": None}), *files.config.cameras[1:])
    unknown = known_requirements(files.config.model_copy(update={"cameras": bare}), None)
    assert not {"width_mm", "resolution_px_per_mm"} & unknown.keys()
    assert unknown["sensor_px_h"] == (WIDTH, "cameras.width")


@pytest.mark.parametrize(("roll_deg", "px_h"), [(0.0, WIDTH), (178.0, WIDTH), (90.0, HEIGHT), (-90.0, HEIGHT)])
def test_the_mounting_of_a_camera_decides_which_side_lies_across_the_motion(
    files: StationFiles, roll_deg: float, px_h: int
) -> None:
    turned = tuple(c.model_copy(update={"nominal_roll_deg": roll_deg}) for c in files.config.cameras)
    known = known_requirements(files.config.model_copy(update={"cameras": turned}), None)
    assert (known["sensor_px_h"][0], known["sensor_px_v"][0]) == (px_h, WIDTH + HEIGHT - px_h)


@pytest.mark.parametrize(
    ("on_us", "expected"), [(80.0, (80.0, "controller.lights")), (900.0, (250.0, "cameras.exposure_us"))]
)
def test_light_that_ends_before_the_exposure_ends_it(files: StationFiles, on_us: float, expected: Any) -> None:
    lights = {"ring": LightConfig(channels=(0,), on_us=on_us)}
    controller = files.config.controller.model_copy(update={"lights": lights})
    assert (
        known_requirements(files.config.model_copy(update={"controller": controller}), None)["exposure_us"] == expected
    )
