"""The check of a light program finds what arming would refuse: all of it at once, with step, key, camera and limit."""

from __future__ import annotations

from dataclasses import replace
from typing import Any

import pytest

from tests.api.held.programs import FIRMWARE, LIMITS, healthy, station_config
from vaoi_station.acquisition.cameras.interface import CameraHealth
from vaoi_station.acquisition.controller.filming_plan import filming_plan
from vaoi_station.acquisition.controller.interface import ControllerLimits
from vaoi_station.acquisition.process.messages import Health
from vaoi_station.errors import InputError
from vaoi_station.model import BoardType
from vaoi_station.runs.lighting.programs import LightPrograms, ProgramCheck

CAMERAS, PX_PER_MM = 2, (8.0, 8.0)


def check(
    program: list[dict[str, Any]] | None, health: Health | None = None, /, line: Any = None, **config: Any
) -> ProgramCheck:
    station = station_config(CAMERAS, **config)
    board = BoardType.model_validate({"name": "b", **({"line": line} if line else {})})
    steps = None if program is None else BoardType.model_validate({"name": "b", "program": program}).program
    checked = LightPrograms(station, PX_PER_MM, lambda: health).check(board, steps)
    stated = [(f.code, f.message, f.values) for f in checked.faults]
    stated += [(n.code, n.message, n.values) for n in checked.unchecked]
    for code, message, values in stated:
        assert code != "invalid-input", message
        words = " ".join(values.values()).replace(",", " ").split()
        assert all(word in message for word in words), "values are written as in the sentence"
    return checked


def found(checked: ProgramCheck) -> list[tuple[int | None, str | None, int | None]]:
    return [(fault.step, fault.field, fault.camera) for fault in checked.faults]


def unchecked(checked: ProgramCheck) -> tuple[str, ...]:
    return tuple(note.message for note in checked.unchecked)


def test_all_faults_are_found_at_once_and_arming_names_them_too() -> None:
    steps: list[dict[str, Any]] = [
        {"light": "blue"},
        {"light": "even", "exposure_us": [1.0, 2.0, 3.0]},
        {"light": "even", "exposure_us": 8000.0, "on_us": 4000.0},
        {"light": "left", "gain_db": 6.0, "exposure_us": 8000.0},
    ]
    checked = check(steps, healthy(CAMERAS))
    assert not checked.usable
    assert found(checked) == [
        (0, "light", None),
        (1, "exposure_us", None),
        (2, "on_us", 0),
        (3, "gain_db", 0),
        (2, "on_us", 1),
        (3, "gain_db", 1),
        (2, "on_us", None),
    ]
    limits = ["one for all cameras, or 2, one per", "at most 3750.0 for camera cam1", "50 … 1000 (the longest pulse"]
    assert all(any(limit in fault.message for fault in checked.faults) for limit in limits)
    board = BoardType.model_validate({"name": "b", "program": steps})
    with pytest.raises(InputError, match=r"'blue'.* is 3, but .*camera cam0.*And 1 more\."):
        filming_plan(station_config(CAMERAS), board, PX_PER_MM)


def test_a_program_that_fits_has_all_its_values() -> None:
    checked = check([{"light": "left", "exposure_us": [90.0]}, {"light": "even", "on_us": 60.0}], healthy(CAMERAS))
    assert (checked.usable, checked.faults, checked.origin) == (True, (), "request")
    assert unchecked(checked) == (
        "It shows when the line is armed whether camera cam0, camera cam1 can expose for the width of the trigger.",
    )
    assert [(s.on_us, s.exposures_us, s.lit_us) for s in checked.steps] == [
        (120.0, (90.0, 90.0), (90.0, 90.0)),
        (60.0, (250.0, 250.0), (60.0, 60.0)),
    ]
    assert checked.steps[0].trigger_us == 90.0
    assert [(light.name, light.on_limits_us) for light in checked.lights] == [
        ("even", (50.0, 1000.0)),
        ("left", (50.0, 500.0)),
    ]
    assert checked.most_steps == 16
    assert checked.cameras[1].longest_lit_us == pytest.approx(3750.0)


@pytest.mark.parametrize(
    ("steps", "firmware", "fault"),
    [
        ([{"light": "even"}] * 17, {}, (None, None, None)),
        ([{"light": "left", "on_us": 20.0}], {}, (0, "on_us", None)),
        ([{"light": "left"}, {"light": "left", "exposure_us": 20.0}], {}, (1, "exposure_us", None)),
        ([{"light": "left"}, {"light": "left", "exposure_us": 90.0}], {"widest_us": 0.0}, (None, "exposure_us", None)),
    ],
)
def test_the_limits_of_the_firmware_count(
    steps: list[dict[str, Any]], firmware: dict[str, Any], fault: tuple[Any, ...]
) -> None:
    limits = ControllerLimits(firmware=replace(FIRMWARE, **firmware))
    assert found(check(steps, replace(healthy(CAMERAS), limits=limits))) == [fault]


def test_the_limits_that_cameras_state_count() -> None:
    checked = check([{"light": "left", "gain_db": [0.0, 24.9]}], healthy(CAMERAS))
    assert found(checked) == [(0, "gain_db", 1)]
    assert "must be 0 … 24 dB, the limits that camera cam1 states" in checked.faults[0].message
    assert check([{"light": "left", "gain_db": 24.2}], healthy(CAMERAS)).usable, "cameras round the gain"
    narrow = CameraHealth(True, limits=replace(LIMITS, exposure_us=(300.0, 400.0)))
    health = replace(healthy(CAMERAS), cameras=(CameraHealth(True, limits=LIMITS), narrow))
    assert found(check([{"light": "left"}], health)) == [(0, "exposure_us", 1)]
    sets = CameraHealth(True, limits=replace(LIMITS, sets=1))
    sequencer = station_config(1).cameras[0].model_copy(update={"exposure_by": "sequencer"})
    two: list[dict[str, Any]] = [{"light": "left"}, {"light": "left", "gain_db": 3.0}]
    checked = check(two, replace(healthy(1), cameras=(sets,)), cameras=(sequencer,))
    assert "number of different steps is 2, but must be at most 1" in checked.faults[0].message
    none = replace(healthy(1), cameras=(CameraHealth(True, limits=LIMITS),))
    checked = check(two, none, cameras=(sequencer,))
    assert [fault.camera for fault in checked.faults] == [0]
    assert "must be 1: camera cam0 has no sequencer, though its exposure_by" in checked.faults[0].message
    assert check(two[:1], none, cameras=(sequencer,)).usable, "one step needs no sequencer"
    enough = replace(healthy(1), cameras=(CameraHealth(True, limits=replace(LIMITS, gain_db=None, sets=2)),))
    checked = check(two, enough, cameras=(sequencer,))
    assert (checked.usable, unchecked(checked)) == (
        True,
        (
            "camera cam0 states no limits of its gain.",
            "It shows when the line is armed whether camera cam0 can advance its sequencer per frame.",
        ),
    )


def test_what_no_device_has_stated_is_said() -> None:
    steps = [{"light": "even"}]
    assert len(check(steps).unchecked) == 1 + CAMERAS
    lost = replace(healthy(CAMERAS), cameras=(CameraHealth(True, limits=LIMITS), CameraHealth(False)))
    checked = check(steps, lost)
    assert checked.usable
    assert unchecked(checked) == ("The limits of camera cam1 are not known: it is not connected.",)


def test_the_lights_of_a_simulated_line_are_those_of_its_scenario() -> None:
    simulated = {"controller": {}, "simulation": {"scenario": "scenario.toml"}}
    cameras = [{"name": f"c{n}", "width": 320, "height": 240, "exposure_us": 250.0} for n in range(CAMERAS)]
    health = Health((CameraHealth(True),) * CAMERAS, "simulated", 0.0, limits=ControllerLimits(("ring",)))
    checked = check([{"light": "ring"}, {"light": "left"}], health, cameras=cameras, **simulated)
    assert found(checked) == [(1, "light", None)]
    assert "must be a light of the scenario, which has 'ring'" in checked.faults[0].message
    assert (unchecked(checked), [light.name for light in checked.lights]) == ((), ["ring"])


def test_without_a_program_the_one_in_force_is_checked_on_the_line_of_the_board_type() -> None:
    assert [step.light for step in check(None, healthy(CAMERAS)).steps] == ["even", "left"]
    station = check(None, healthy(CAMERAS), program=[{"light": "left"}])
    assert (station.origin, [step.light for step in station.steps]) == ("station", ["left"])
    assert check(None, healthy(CAMERAS)).origin == check([], healthy(CAMERAS)).origin == "cameras"
    narrow = CameraHealth(True, limits=replace(LIMITS, exposure_us=(300.0, 400.0)))
    checked = check(None, replace(healthy(CAMERAS), cameras=(narrow, narrow)))
    assert [(fault.step, fault.camera) for fault in checked.faults] == [(None, 0), (None, 1)]
    assert "station.toml: cameras.1.exposure_us is 250.0, but must be 300 … 400 µs" in checked.faults[1].message
    fast = check([{"light": "left"}], healthy(CAMERAS), line={"speed_mm_s": 300.0})
    assert "line.speed_mm_s is 300.0, but must be 100" in fast.faults[0].message


@pytest.mark.parametrize("program", [None, [{"light": "left", "on_us": 60.0}]])
def test_rows_that_follow_faster_than_a_camera_is_read_out_are_a_fault(program: list[dict[str, Any]] | None) -> None:
    slow = [camera.model_copy(update={"readout_us": 20_000.0}) for camera in station_config(CAMERAS).cameras]
    dense: dict[str, Any] = {"row_mm": 1.0, "longest_board_mm": 20.0, "tail_s": 0.2}
    checked = check(program, healthy(CAMERAS), line=dense, cameras=slow)
    assert [(fault.camera, fault.field) for fault in checked.faults] == [(n, program and "exposure_us") for n in (0, 1)]
    station, board = station_config(CAMERAS, cameras=slow), BoardType.model_validate({"name": "b", "line": dense})
    with pytest.raises(InputError, match=r"at least 0\.02025: camera 'cam0' exposes for 250 µs .* camera 'cam1'"):
        filming_plan(station, board, PX_PER_MM)
