"""Round numbers for axes, colours for numbers, and numbers as text."""

from __future__ import annotations

import math
from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.reporting.drawing.scales import Scale, about_zero, number, round_down, round_up, ticks

sizes = st.floats(1e-9, 1e9)
finite = st.floats(-1e6, 1e6)


@given(sizes)
def test_round_numbers_enclose(value: float) -> None:
    low, high = round_down(value), round_up(value)
    assert low <= value * (1 + 1e-9)
    assert value <= high * (1 + 1e-9)
    assert high / low <= 2.5 + 1e-9
    for found in (low, high):
        digit = found / 10 ** math.floor(math.log10(found) + 1e-9)
        assert digit == pytest.approx(1) or digit == pytest.approx(2) or digit == pytest.approx(5)


@given(finite, sizes.filter(lambda v: 1e-3 < v < 1e6))
def test_ticks_are_evenly_spaced_and_inside(low: float, span: float) -> None:
    found = ticks(low, low + span)
    assert 1 <= len(found) <= 8
    assert all(low - 1e-6 * span <= t <= low + span * (1 + 1e-6) for t in found)
    steps = {round((b - a) / span, 5) for a, b in pairwise(found)}
    assert len(steps) <= 1


@given(finite, st.lists(finite, max_size=5))
def test_every_number_has_a_colour(value: float, others: list[float]) -> None:
    for scale in (Scale(0, 1), Scale(3, 3), about_zero(others, 0.02)):
        colour = scale(value)
        assert len(colour) == 7
        int(colour[1:], 16)


def test_colours_at_the_ends() -> None:
    scale = Scale(0, 10, ((0, 0, 0), (100, 200, 50)))
    assert [scale(v) for v in (-5, 0, 5, 10, 99)] == ["#000000", "#000000", "#326419", "#64c832", "#64c832"]


@pytest.mark.parametrize(
    ("value", "digits", "written"),
    [(None, 3, "–"), (float("nan"), 3, "–"), (-0.5, 2, "−0.50"), (-1e-9, 3, "0.000"), (12.0, 0, "12"), (0.0, 1, "0.0")],
)
def test_numbers_as_text(value: float | None, digits: int, written: str) -> None:
    assert number(value, digits) == written
