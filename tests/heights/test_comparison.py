"""Statements about expected heights, and the document of heights."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.heights.comparison import compare, heights_document
from vaoi_station.heights.estimates import NOTHING, Interval, PartHeight
from vaoi_station.model import BoardType


def measured(mm: float, sigma: float) -> PartHeight:
    return PartHeight(mm, sigma, (), 3)


def among(*intervals: tuple[float, float, float]) -> PartHeight:
    return PartHeight(None, None, tuple(Interval(*i) for i in intervals), 2)


@pytest.mark.parametrize(
    ("height", "statement"),
    [
        (measured(1.02, 0.02), "agrees"),
        (measured(0.01, 0.05), "lower"),
        (measured(1.6, 0.05), "higher"),
        (measured(0.9, 0.1), "unknown"),
        (measured(1.25, 0.05), "unknown"),
        (among((2.0, 5.0, 0.998)), "higher"),
        (among((0.0, 5.0, 0.998)), "unknown"),
        (among((1.12, 5.0, 0.998)), "unknown"),  # the end of a wide interval is not sharp
        (among((1.12, 1.3, 0.998)), "higher"),
        (among((0.0, 0.3, 0.998)), "lower"),
        (among((0.95, 1.05, 0.6), (8.0, 9.0, 0.398)), "ambiguous"),
        (among((0.95, 1.05, 0.01), (8.0, 9.0, 0.988)), "ambiguous"),
        (among((0.95, 1.05, 0.97), (8.0, 9.0, 0.028)), "agrees"),
        (among((2.0, 3.0, 0.5), (8.0, 9.0, 0.498)), "higher"),
        (NOTHING, "unknown"),
    ],
)
def test_statements_about_a_body_of_one_millimetre(height: PartHeight, statement: str) -> None:
    assert compare(height, 1.0)[0] == statement


@given(st.floats(-1, 12), st.floats(0.005, 2), st.floats(0.1, 10))
def test_a_statement_has_at_least_its_probability(mm: float, sigma: float, expected: float) -> None:
    statement, probability = compare(measured(mm, sigma), expected)
    assert 0 <= probability <= 1
    assert (statement == "unknown") or probability >= (0.95 if statement == "agrees" else 0.995)
    assert statement != "unknown" or probability < 0.995


def test_the_document_has_heights_in_mm_and_expectations_of_the_board_type() -> None:
    board = BoardType(
        name="b",
        unit="inch",
        outline=((0, 0), (2, 2)),
        components=[
            {"ref": "U1", "center": (1, 1), "width": 0.1, "height": 0.1, "body_height": 0.04},
            {"ref": "R1", "center": (1, 0.5), "width": 0.1, "height": 0.1, "panel": "A"},
            {"ref": "R2", "center": (1, 0.7), "width": 0.1, "height": 0.1},
        ],
    )
    found = {
        "U1": measured(1.01234, 0.02),
        "A/R1": among((0.5, 2.0, 0.998)),
        "R2": among((0.5, 1.0, 0.6), (7.0, 8.0, 0.39812)),
    }
    assert heights_document(found, board) == {
        "U1": {
            "height_mm": 1.0123,
            "sigma_mm": 0.02,
            "views": 3,
            "expected_mm": 1.016,
            "comparison": "agrees",
            "probability": 0.9907,
        },
        "A/R1": {"height_mm": None, "sigma_mm": None, "views": 2, "low_mm": 0.5, "high_mm": 2.0},
        "R2": {
            "height_mm": None,
            "sigma_mm": None,
            "views": 2,
            "low_mm": 0.5,
            "high_mm": 8.0,
            "intervals": [
                {"low_mm": 0.5, "high_mm": 1.0, "probability": 0.6},
                {"low_mm": 7.0, "high_mm": 8.0, "probability": 0.3981},
            ],
        },
    }
