"""Accuracy of the detection of marks, as `vaoi bench --marks` measures it."""

from __future__ import annotations

import math

import pytest

from vaoi_station.benchmarks.marks import (
    measure_mark_kind,
)
from vaoi_station.marks.mark_shape import Shape

SHAPES: list[Shape] = ["circle", "cross", "square", "diamond"]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("light", [True, False])
def test_marks_are_located_within_the_specified_errors(shape: Shape, light: bool) -> None:
    for size in (12.0, 40.0):
        rows = {r.condition: r for r in measure_mark_kind(shape, light, size, 8)}
        assert {r.found for r in rows.values()} == {8}, "none is refused"
        assert rows["clean"].largest_px <= 0.015
        assert rows["slope"].largest_px <= 0.02
        assert rows["noise"].rms_px <= 0.015
        assert rows["noise"].largest_px <= 0.05
        assert rows["copper"].largest_px <= 0.1
        assert 0.5 * rows["noise"].rms_px < rows["noise"].claimed_px < 3 * rows["noise"].rms_px
        assert rows["noise"].rms_px < (rows["noise"].paper_rms_px or math.inf)


DARK, LIGHT = 50.0, 200.0
