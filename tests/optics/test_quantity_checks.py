from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.errors import InputError
from vaoi_station.optics.quantity_checks import (
    ceil_to_whole,
    is_number,
    require,
    require_non_negative,
    require_positive,
)


@pytest.mark.parametrize("value", [0, -3, 1.5, 10**30])
def test_finite_numbers_are_numbers(value: object) -> None:
    assert is_number(value)


@pytest.mark.parametrize("value", [True, "3", None, float("nan"), float("inf"), [1], 1j])
def test_other_values_are_not(value: object) -> None:
    assert not is_number(value)


def test_a_refusal_names_place_quantity_value_and_limit() -> None:
    require(True, "width_mm", 3, "above 0")
    with pytest.raises(InputError, match="plan: width_mm is -3, but must be above 0"):
        require(False, "width_mm", -3, "above 0", where="plan")


def test_the_first_invalid_quantity_is_named() -> None:
    require_positive(a_mm=1e-9, b_mm=2)
    with pytest.raises(InputError, match="b_mm is 0, but must be a finite number above 0"):
        require_positive(a_mm=1, b_mm=0, c_mm=-1)


def test_zero_is_accepted_where_only_negative_numbers_are_refused() -> None:
    require_non_negative(readout_us=0)
    with pytest.raises(InputError, match="readout_us is -1, but must be a finite number, 0 or above"):
        require_non_negative(readout_us=-1)


@given(st.integers(0, 10**6), st.floats(-1e-12, 1e-12))
def test_rounding_errors_add_nothing(whole: int, error: float) -> None:
    assert ceil_to_whole(whole + error) == whole


@given(st.integers(0, 10**5), st.floats(0.01, 0.99))
def test_a_remainder_adds_one(whole: int, remainder: float) -> None:
    assert ceil_to_whole(whole + remainder) == whole + 1 == math.ceil(whole + remainder)
