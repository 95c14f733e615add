"""Limits of parts: the closest level counts, measures are compared each its own way, the unknown is not marked."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from vaoi_station.model import BoardLimits, BoardType
from vaoi_station.model.part_limits import beyond


def test_of_several_limits_that_of_the_part_counts_then_that_of_its_package() -> None:
    limits = BoardLimits.model_validate(
        {
            "every": {"presence": 0.5, "dx_mm": 0.3},
            "packages": {"0603": {"dx_mm": 0.1, "alike": 0.2}},
            "parts": {"R1": {"dx_mm": 0.0}},
        }
    )
    assert limits.by_part({"R1": "0603", "R2": "0603", "U1": None}) == {
        "R1": {"presence": 0.5, "dx_mm": 0.0, "alike": 0.2},
        "R2": {"presence": 0.5, "dx_mm": 0.1, "alike": 0.2},
        "U1": {"presence": 0.5, "dx_mm": 0.3},
    }
    assert BoardLimits().by_part({"R1": "0603"}) == {}


@pytest.mark.parametrize(
    ("limits", "measure", "marked"),
    [
        ({"presence": 0.5}, {"presence": 0.49}, ["presence"]),
        ({"presence": 0.5}, {"presence": 0.5}, []),
        ({"dx_mm": 0.1, "dy_mm": 0.1}, {"dx_mm": -0.11, "dy_mm": 0.1}, ["dx_mm"]),
        ({"turn_deg": 10}, {"turn_deg": -180.0}, ["turn_deg"]),
        ({"orientation": 0.5}, {"orientation": {"0": 0.1, "180": 0.9}}, ["orientation"]),
        ({"orientation": 0.5}, {"orientation": None}, []),
        ({"least_height_mm": 0.2}, {"height_mm": 0.1}, ["height_mm"]),
        ({"most_height_mm": 0.2}, {"height_mm": 0.3}, ["height_mm"]),
        ({"presence": 1.0, "alike": 1.0, "dx_mm": 0.0}, {"presence": None, "reasons": ["unseen"]}, []),
    ],
)
def test_a_measure_beyond_its_limit_is_marked(limits: Any, measure: Any, marked: list[str]) -> None:
    assert beyond(limits, measure) == marked


def test_limits_change_nothing_on_which_runs_depend() -> None:
    board_type = BoardType(name="b")
    limited = BoardType.model_validate({"name": "b", "limits": {"every": {"alike": 0.1}}})
    assert limited.filmed_digest() == board_type.filmed_digest()


@pytest.mark.parametrize("wrong", [{"presence": 1.5}, {"dx_mm": -1}, {"turn_deg": float("nan")}, {"presense": 0.5}])
def test_wrong_limits_are_refused(wrong: Any) -> None:
    with pytest.raises(ValidationError):
        BoardLimits.model_validate({"every": wrong})
