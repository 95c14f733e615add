"""The trigger plan of a board type, and the faults of its light program."""

from __future__ import annotations

from collections.abc import Callable
from typing import Any

import pytest

from vaoi_station.acquisition.cameras.interface import CameraExposure, CameraLimits
from vaoi_station.acquisition.controller.filming_plan import (
    MOST_SHOWN,
    ProgramFault,
    beyond_camera,
    exposures_of,
    filming_plan,
    line_of_board,
    require_none,
)
from vaoi_station.acquisition.controller.interface import BeltPacing
from vaoi_station.config import StationConfig
from vaoi_station.errors import InputError
from vaoi_station.model import BoardType, ProgramRow

LIMITS = CameraLimits((20.0, 1000.0), (0.0, 24.0), sets=2)


def test_one_error_names_all_faults_once_and_counts_those_it_does_not_show() -> None:
    require_none([])
    single = InputError("a.", action="Do it.")
    with pytest.raises(InputError) as raised:
        require_none([ProgramFault(single)])
    assert raised.value is single
    errors = [InputError("a."), InputError("b.", action="Do b."), InputError("a.")]
    with pytest.raises(InputError, match=r"^a\. b\. Do b\.$"):
        require_none([ProgramFault(error) for error in errors])
    with pytest.raises(InputError, match=r"4\. And 2 more\.$"):
        require_none([ProgramFault(InputError(f"{n}.")) for n in range(MOST_SHOWN + 2)])


def found(wanted: CameraExposure, gains_db: tuple[float, ...] = (0.0,)) -> list[tuple[int | None, str]]:
    return [(fault.step, fault.key) for fault in beyond_camera(wanted, gains_db, LIMITS, 0, "camera a")]


def test_a_register_may_be_rounded_and_the_sets_of_a_sequencer_are_compared_exactly() -> None:
    assert found(CameraExposure((1001.0,), 0.0)) == []
    assert found(CameraExposure((1021.0,), 0.0)) == [(0, "exposure_us")]
    assert found(CameraExposure((100.0,), 0.0), (24.2, 24.5)) == [(1, "gain_db")]
    sets = ((1001.0, 0.0), (100.0, 0.0))
    assert found(CameraExposure((1001.0, 100.0), 0.0, sequence=sets), (0.0, 0.0)) == [(0, "exposure_us")]
    assert found(CameraExposure((100.0,) * 3, 0.0, sequence=((100.0, 0.0),) * 3)) == [(None, "")]


Make = Callable[..., StationConfig]
LIGHTS = {"ring": {"channels": [0], "on_us": 100.0}, "left": {"channels": [1], "on_us": 60.0}}
RESOLUTION = (4.0, 4.0)


def board(**keys: Any) -> BoardType:
    return BoardType.model_validate({"name": "b", **keys})


@pytest.fixture
def serial(make_config: Make) -> StationConfig:
    """A station with real cameras and two lights, on a belt of 100 mm/s with a period of 50 ms."""
    cameras = [{**c.model_dump(), "backend": "aravis", "serial": c.name} for c in make_config().cameras]
    return make_config(simulation=None, cameras=cameras, controller={"backend": "serial", "lights": LIGHTS})


def test_a_program_is_completed_from_the_station(serial: StationConfig) -> None:
    plan = filming_plan(serial, board(program=[{"light": "left"}, {"light": "ring", "on_us": 50.0}]))
    shutters_us = tuple(camera.exposure_us for camera in serial.cameras)
    assert plan.lights == ("left", "ring")
    assert plan.program == (
        ProgramRow("left", shutters_us, (0.0, 0.0), 60.0),
        ProgramRow("ring", shutters_us, (0.0, 0.0), 50.0),
    )


def test_the_width_of_the_trigger_makes_exposures_that_differ(serial: StationConfig) -> None:
    steps = [{"light": "left", "exposure_us": [200.0, 300.0]}, {"light": "ring", "exposure_us": [50.5, 300.0]}]
    plan = filming_plan(serial, board(program=steps))
    assert plan.by_trigger == (0,)
    assert [row.trigger_us for row in plan.program] == [200.0, 50.5]
    assert [(e.exposures_us, e.by_trigger) for e in exposures_of(plan, serial)] == [
        ((200.0, 50.5), True),
        ((300.0, 300.0), False),
    ]
    fixed = _with_cameras(serial, exposure_by="trigger-width")
    with pytest.raises(
        InputError, match=r"program\.0\.exposure_us is 300\.0, but must be 200 µs as for camera c0: the"
    ):
        filming_plan(fixed, board(program=steps))
    same = filming_plan(fixed, board(program=[{"light": "left", "exposure_us": 80.0}]))
    assert (same.by_trigger, same.program[0].trigger_us) == ((0, 1), 80.0)
    assert filming_plan(fixed).by_trigger == ()


@pytest.mark.parametrize(
    ("program", "words"),
    [
        ([{"light": "blue"}], r"program\.0\.light is 'blue', but must be a light of .* which has 'ring', 'left'"),
        ([{"light": "left", "exposure_us": 51000.0}], r"program\.0\.exposure_us is 51000\.0, but must be at most 5"),
        (
            [{"light": "left", "exposure_us": 9000.0, "on_us": 8000.0}],
            r"program\.0\.on_us is 8000\.0, but must be at most 7500\.0 for camera c0: at 100 mm/s and 4 px/mm the "
            r"picture moves 3 px",
        ),
        (
            [{"light": "left", "exposure_us": [1.0, 2.0, 3.0]}],
            r"number of entries of program\.0\.exposure_us is 3, but must be one for all cameras, or 2",
        ),
        (
            [{"light": "left", "exposure_us": 200.0}, {"light": "left", "exposure_us": 12.0}],
            r"program\.1\.exposure_us is 12\.0, but must be 200 µs as in program\.0: camera c0 has one exposure_us for",
        ),
        (
            [{"light": "left"}, {"light": "left", "gain_db": 3.0}],
            r"program\.1\.gain_db is 3\.0, but must be 0 dB as in program\.0",
        ),
    ],
)  # fmt: skip
def test_what_does_not_fit_is_refused_with_the_numbers(
    serial: StationConfig, program: list[dict[str, Any]], words: str
) -> None:
    registers = _with_cameras(serial, exposure_by="register")
    with pytest.raises(InputError, match=f"board type 'b': {words}"):
        filming_plan(registers, board(program=program), RESOLUTION)


def test_the_belt_spaces_the_rows_where_station_or_board_type_ask_for_it(serial: StationConfig) -> None:
    config = _with_line(serial, encoder={"counts_per_mm": 20.0})
    assert filming_plan(config).belt is None
    plan = filming_plan(config, board(line={"pacing": "encoder", "row_mm": 4.0}))
    assert plan.belt is not None
    assert (plan.belt.row, plan.row_mm, plan.period_s) == (80, 4.0, 0.04)
    assert plan.shortest_period_s == pytest.approx(0.032)
    assert plan.longest_period_s == pytest.approx(0.16)
    by_station = _with_line(config, pacing="encoder")
    assert filming_plan(by_station).belt == BeltPacing.of(by_station.line)
    assert filming_plan(by_station, board(line={"pacing": "time"})).belt is None
    with pytest.raises(InputError, match=r'board type .b.: line: pacing is "encoder", but there is no table'):
        filming_plan(serial, board(line={"pacing": "encoder"}))
    with pytest.raises(InputError, match=r"line: encoder\.counts_per_mm is 20: rows lie 0\.02 mm, 0\.4 counts, apart"):
        filming_plan(config, board(line={"pacing": "encoder", "row_mm": 0.02}))


@pytest.mark.parametrize(
    ("line", "words"),
    [
        ({"speed_mm_s": 90.0}, r"line\.speed_mm_s is 90\.0, but must be 100 as in station.toml, which states no "),
        ({"rail_mm": 3.0}, r"line\.rail_mm is 3\.0, but must be -20 … 0, line\.rail_limits_mm in station\.toml"),
        ({"longest_board_mm": 30.0}, r"line\.longest_board_mm is 30\.0, but must be at most 22, line\.longest"),
        ({"tail_s": 9.0}, r"line\.tail_s is 9\.0, but must be shorter: it gives \d+ rows, but the ring has \d+ slots"),
        ({"tail_s": 0.0, "longest_board_mm": 5.0}, r"line\.tail_s is 0\.0, but must be at least 0\.070, else no pulse"),
    ],
)  # fmt: skip
def test_what_the_line_cannot_do_is_refused_with_the_numbers(
    serial: StationConfig, line: dict[str, float], words: str
) -> None:
    config = _with_line(serial, expected_board={"rail_mm": -10.0}, rail_limits_mm=(-20.0, 0.0))
    with pytest.raises(InputError, match=f"board type 'b': {words}"):
        line_of_board(config, board(line=line))


def _with_cameras(config: StationConfig, **keys: Any) -> StationConfig:
    return config.model_copy(update={"cameras": tuple(c.model_copy(update=keys) for c in config.cameras)})


def _with_line(config: StationConfig, **keys: Any) -> StationConfig:
    line = type(config.line).model_validate({**config.line.model_dump(), **keys})
    return config.model_copy(update={"line": line})


def _steps(*exposures: tuple[float, float]) -> BoardType:
    """Return a board type whose program has these exposures (µs) and gains (dB) for camera 0."""
    keys = [{"exposure_us": [us, 200.0], "gain_db": [db, 0.0]} for us, db in exposures]
    return board(program=[{"light": "left", **key} for key in keys])


@pytest.mark.parametrize(
    ("exposures", "words"),
    [
        (((100.0, 0.0), (139.9, 0.0)), r"program\.1\.exposure_us is 139\.9, but must be 100 as in program\.0, or at "
         r"least 40 µs from it: by what the frames of camera c0 state"),
        (((4000.0, 0.0), (9.0, 0.0), (4079.0, 0.0)), r"program\.2\.exposure_us is 4079\.0, .* or at least 80\.79 µs"),
        (((100.0, 0.0), (300.0, 0.0), (100.0, 0.5)), r"program\.2\.gain_db is 0\.5, but must be 0 as in program\.0, or "
         r"at least 0\.6 dB from it"),
        (((100.0, 0.0), (110.0, 0.5)), r"program\.1\.exposure_us is 110\.0"),
    ],
)  # fmt: skip
def test_steps_of_a_sequencer_that_frames_do_not_distinguish_are_refused(
    serial: StationConfig, exposures: tuple[tuple[float, float], ...], words: str
) -> None:
    with pytest.raises(InputError, match=words):
        filming_plan(_with_cameras(serial, exposure_by="sequencer"), _steps(*exposures))
