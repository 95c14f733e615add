from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.optics.constraint import at_least, at_most, not_checked

numbers = st.floats(-1e6, 1e6)


@given(numbers, numbers)
def test_a_constraint_holds_if_its_margin_is_not_negative(value: float, limit: float) -> None:
    for c in (at_most("n", "e", value, limit, unit="mm"), at_least("n", "e", value, limit, unit="mm")):
        assert c.margin is not None
        assert c.ok is (c.margin >= 0)
        assert (c.value, c.limit, c.unit) == (value, limit, "mm")


@given(numbers, numbers)
def test_both_relations_have_opposite_margins(value: float, limit: float) -> None:
    above, below = at_least("n", "e", value, limit, unit=""), at_most("n", "e", value, limit, unit="")
    assert (above.relation, below.relation) == ("≥", "≤")
    assert above.margin is not None
    assert below.margin is not None
    assert above.margin == -below.margin


@given(st.floats(1e-3, 1e6))
def test_rounding_does_not_violate_an_equality(limit: float) -> None:
    assert at_most("n", "e", limit * (1 + 1e-12), limit, unit="").margin == 0
    assert at_least("n", "e", limit * (1 - 1e-12), limit, unit="").margin == 0
    assert at_most("n", "e", limit * (1 + 1e-6), limit, unit="").ok is False


@pytest.mark.parametrize("value", [None, 3.5])
def test_a_constraint_with_a_missing_quantity_is_neither_met_nor_violated(value: float | None) -> None:
    c = not_checked("links", "n·t", "≤", unit="Mbit/s", note="none given", missing=("link_mbit_s",), value=value)
    assert (c.ok, c.limit, c.margin, c.value, c.note) == (None, None, None, value, "none given")
    assert (c.missing, at_most("n", "e", 1, 2, unit="").missing) == (("link_mbit_s",), ())
