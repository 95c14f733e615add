"""The documents about light programs: absent values are left out, unknown keys are refused."""

from __future__ import annotations

import pytest
from pydantic import ValidationError

from vaoi_station.runs.lighting.program_schemas import ProgramFaultEntry, ProgramStepValues


def test_values_that_are_absent_are_left_out() -> None:
    step = ProgramStepValues(light="ring", exposures_us=(100.0,), gains_db=(0.0,), lit_us=(100.0,))
    assert step.model_dump(exclude_none=True).keys() == {"light", "exposures_us", "gains_db", "lit_us"}
    assert ProgramFaultEntry(message="a.", code="b", values={}).model_dump(exclude_none=True).keys() == {
        "message",
        "code",
        "values",
    }


def test_unknown_keys_are_refused() -> None:
    with pytest.raises(ValidationError, match="camra"):
        ProgramFaultEntry.model_validate({"message": "a.", "camra": 1})
