"""Figures that may be absent, in JSON and in tables."""

from __future__ import annotations

import json
import math

import pytest

from vaoi_station.benchmarks.figure_formats import json_document, number


def test_numbers_that_json_lacks_become_null_at_any_depth() -> None:
    document = json_document({"a": math.nan, "b": [1.5, {"c": math.inf}], "d": (1, "x", None, True, -math.inf)})
    assert document == {"a": None, "b": [1.5, {"c": None}], "d": [1, "x", None, True, None]}
    json.dumps(document, allow_nan=False)


@pytest.mark.parametrize(
    ("value", "text"), [(1.256, "1.26"), (0.0, "0.00"), (None, "–"), (math.nan, "–"), (math.inf, "–")]
)
def test_an_absent_figure_is_a_dash(value: float | None, text: str) -> None:
    assert number(value, 2) == text
