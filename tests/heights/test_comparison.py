"""Statements about expected heights, and the document of heights."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.heights.comparison import compare, heights_document
from vaoi_station.heights.estimates import NOTHING, PartHeight
from vaoi_station.model import BoardType


def measured(mm: float, sigma: float) -> PartHeight:
    return PartHeight(mm, sigma, None, None, 3)


@pytest.mark.parametrize(
    ("height", "statement"),
    [
        (measured(1.02, 0.02), "agrees"),
        (measured(0.01, 0.05), "lower"),
        (measured(1.6, 0.05), "higher"),
        (measured(0.9, 0.1), "unknown"),
        (PartHeight(None, None, 2.0, 5.0, 2), "higher"),
        (PartHeight(None, None, 0.0, 5.0, 2), "unknown"),
        (NOTHING, "unknown"),
    ],
)
def test_statements_about_a_body_of_one_millimetre(height: PartHeight, statement: str) -> None:
    assert compare(height, 1.0)[0] == statement


@given(st.floats(-1, 12), st.floats(0.005, 2), st.floats(0.1, 10))
def test_a_statement_has_at_least_its_probability(mm: float, sigma: float, expected: float) -> None:
    statement, probability = compare(measured(mm, sigma), expected)
    assert 0 <= probability <= 1
    assert (statement == "unknown") == (probability < 0.95)


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
    found = {"U1": measured(1.01234, 0.02), "A/R1": PartHeight(None, None, 0.5, 2.0, 2)}
    assert heights_document(found, board) == {
        "U1": {
            "height_mm": 1.0123,
            "sigma_mm": 0.02,
            "views": 3,
            "expected_mm": 1.016,
            "comparison": "agrees",
            "probability": 1.0,
        },
        "A/R1": {"height_mm": None, "sigma_mm": None, "views": 2, "low_mm": 0.5, "high_mm": 2.0},
    }
