"""Tests of light programs: what a step accepts, and what a row is filmed with."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from vaoi_station.model import BoardType, ProgramRow, ProgramStep
from vaoi_station.model.light_program import linear_gain, row_of, usual_light


def test_one_number_applies_to_all_cameras() -> None:
    step = ProgramStep.model_validate({"light": "left", "on_us": 80, "exposure_us": 200.0, "gain_db": [0.0, 6.0]})
    assert (step.exposure_us, step.gain_db) == ((200.0,), (0.0, 6.0))
    assert ProgramStep.model_validate_json(step.model_dump_json()) == step


@pytest.mark.parametrize(
    "wrong",
    [{"on_us": 0}, {"exposure_us": "200"}, {"exposure_us": []}, {"gain_db": [90.0]}, {"light": ""}, {"lamp": 1}],
)
def test_impossible_values_are_refused(wrong: dict[str, Any]) -> None:
    with pytest.raises(ValidationError):
        ProgramStep.model_validate({"light": "left", **wrong})


def test_a_board_type_has_at_most_64_steps() -> None:
    with pytest.raises(ValidationError, match="at most 64"):
        BoardType.model_validate({"name": "b", "program": [{"light": "left"}] * 65})


def test_a_frame_is_lit_for_the_shorter_of_exposure_and_on_time() -> None:
    row = ProgramRow("left", (200.0, 50.0), (0.0, 20.0), on_us=80.0)
    assert row.lit_us == (80.0, 50.0)
    assert row.gains == (1.0, 10.0)
    assert ProgramRow("left", (200.0, 50.0), (0.0, 0.0)).lit_us == (200.0, 50.0)
    assert linear_gain(6.0) == pytest.approx(1.995262)


def test_the_steps_repeat_over_the_rows() -> None:
    a, b = (ProgramRow(name, (1.0,), (0.0,)) for name in ("a", "b"))
    assert [row_of((a, b), row) for row in range(3)] == [a, b, a]
    assert row_of((), 5) is None


def test_the_usual_light_is_that_of_most_frames_and_else_the_first() -> None:
    assert usual_light(["left", None, "right", "right"]) == "right"
    assert usual_light(["left", "right"]) == "left"
    assert usual_light([None, "left"]) is None
    assert usual_light([]) is None
