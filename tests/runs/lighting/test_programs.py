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


@pytest.mark.parametrize("program", [None, [{"light": "left", "on_us": 60.0}]])
def test_rows_that_follow_faster_than_a_camera_is_read_out_are_a_fault(program: list[dict[str, Any]] | None) -> None:
    slow = [camera.model_copy(update={"readout_us": 20_000.0}) for camera in station_config(CAMERAS).cameras]
    dense: dict[str, Any] = {"row_mm": 1.0, "longest_board_mm": 20.0, "tail_s": 0.2}
    checked = check(program, healthy(CAMERAS), line=dense, cameras=slow)
    assert [(fault.camera, fault.field) for fault in checked.faults] == [(n, program and "exposure_us") for n in (0, 1)]
    station, board = station_config(CAMERAS, cameras=slow), BoardType.model_validate({"name": "b", "line": dense})
    with pytest.raises(InputError, match=r"at least 0\.02025: camera 'cam0' exposes for 250 µs .* camera 'cam1'"):
        filming_plan(station, board, PX_PER_MM)
