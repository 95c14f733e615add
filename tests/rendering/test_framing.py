"""Framings of component images: values outside their limits are refused with the value and the limit."""

from __future__ import annotations

from typing import Any

import pytest

from vaoi_station.errors import InputError
from vaoi_station.rendering.framing import Framing, is_number


@pytest.mark.parametrize(
    ("values", "words"),
    [
        ({"px_per_mm": 0.05}, "px_per_mm is 0.05, but must be None or a number from 0.1 to 1000"),
        ({"px_per_mm": float("nan")}, "px_per_mm is nan"),
        ({"margin_mm": -1}, "margin_mm is -1, but must be a number from 0 to 100"),
        ({"margin_mm": 250.0}, "margin_mm is 250.0, but must be a number from 0 to 100"),
        ({"margin_mm": True}, "margin_mm is True"),
        ({"align": "north"}, "align is 'north', but must be 'cad' or 'part'"),
        ({"plane": "roof"}, "plane is 'roof', but must be 'board' or 'top'"),
    ],
)
def test_a_value_outside_its_limits_is_refused(values: dict[str, Any], words: str) -> None:
    with pytest.raises(InputError) as refused:
        Framing(**values).check()
    assert words in str(refused.value)


def test_the_limits_themselves_are_accepted() -> None:
    for framing in (Framing(), Framing(0.1, 100.0, "part", "top"), Framing(1000, 0)):
        assert framing.check() is framing


@pytest.mark.parametrize(
    ("value", "number"), [(1, True), (0.5, True), (True, False), (float("nan"), False), ("1", False)]
)
def test_numbers(value: object, number: bool) -> None:
    assert is_number(value) is number
