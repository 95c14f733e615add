"""The tables of what lies beside the board: defaults that change nothing, and limits."""

from __future__ import annotations

from typing import Any

import pytest
from pydantic import ValidationError

from vaoi_station.simulation import Scenario, Twin


def test_the_defaults_are_an_even_belt_without_a_carrier() -> None:
    scenario = Scenario()
    assert scenario.texture.sigma_grey == 0
    assert scenario.carrier.rim_mm == 0
    assert Twin(scenario).scene.surroundings is None


@pytest.mark.parametrize(
    ("table", "key", "value"),
    [
        ("texture", "sigma_grey", -1.0),
        ("texture", "follows", 3.0),
        ("texture", "grain_mm", 0.0),
        ("carrier", "rim_mm", -1.0),
        ("carrier", "grey", 300.0),
        ("carrier", "marks", [{"x_mm": 1.0}]),
    ],
)
def test_values_beyond_their_limits_are_refused(table: str, key: str, value: Any) -> None:
    with pytest.raises(ValidationError, match=key):
        Scenario.model_validate({table: {key: value}})


def test_marks_of_a_carrier_may_lie_beside_the_board() -> None:
    scenario = Scenario.model_validate({"carrier": {"rim_mm": 9.0, "marks": [{"x_mm": -5.0, "y_mm": 4.0}]}})
    assert scenario.carrier.marks[0].x_mm == -5
