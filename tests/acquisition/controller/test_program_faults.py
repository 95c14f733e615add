"""Faults of a light program: together in one error, with the lights of a simulated line and the limits of cameras."""

from __future__ import annotations

import pytest

from vaoi_station.acquisition.cameras.interface import CameraExposure, CameraLimits
from vaoi_station.acquisition.controller.filming_plan import (
    MOST_SHOWN,
    ProgramFault,
    beyond_camera,
    require_none,
    unknown_lights,
)
from vaoi_station.errors import InputError
from vaoi_station.model import ProgramRow

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


def test_a_light_that_the_line_lacks_is_named_with_its_step() -> None:
    rows = [ProgramRow(name, (100.0,), (0.0,)) for name in ("ring", "left")]
    found = unknown_lights(rows, ("ring",))
    assert [(fault.step, fault.key) for fault in found] == [(1, "light")]
    assert "program.1.light is 'left', but must be a light of the scenario, which has 'ring'" in found[0].error.message


def found(wanted: CameraExposure, gains_db: tuple[float, ...] = (0.0,)) -> list[tuple[int | None, str]]:
    return [(fault.step, fault.key) for fault in beyond_camera(wanted, gains_db, LIMITS, 0, "camera a")]


def test_a_register_may_be_rounded_and_the_sets_of_a_sequencer_are_compared_exactly() -> None:
    assert found(CameraExposure((1001.0,), 0.0)) == []
    assert found(CameraExposure((1021.0,), 0.0)) == [(0, "exposure_us")]
    assert found(CameraExposure((100.0,), 0.0), (24.2, 24.5)) == [(1, "gain_db")]
    sets = ((1001.0, 0.0), (100.0, 0.0))
    assert found(CameraExposure((1001.0, 100.0), 0.0, sequence=sets), (0.0, 0.0)) == [(0, "exposure_us")]
    assert found(CameraExposure((100.0,) * 3, 0.0, sequence=((100.0, 0.0),) * 3)) == [(None, "")]


def test_the_width_of_the_trigger_has_no_limit_of_the_register() -> None:
    assert found(CameraExposure((5000.0,), 0.0, by_trigger=True)) == []
    silent = CameraLimits()
    assert list(beyond_camera(CameraExposure((5000.0,), 90.0), (90.0,), silent, 0, "camera a")) == []
