from __future__ import annotations

import math
from dataclasses import replace
from typing import Any

import numpy as np
import pytest

from vaoi_station.benchmarks.marks import Curve, MarkFigures, _curve, _rows
from vaoi_station.benchmarks.painted import bound_px, film, paint
from vaoi_station.marks.mark_shape import Shape

SHAPES: list[Shape] = ["circle", "cross", "square", "diamond"]


@pytest.mark.parametrize("shape", SHAPES)
@pytest.mark.parametrize("light", [True, False])
def test_marks_reach_what_is_promised_of_them(shape: Shape, light: bool) -> None:
    for size in (12.0, 40.0):
        rows = {r.condition: r for r in _rows(shape, light, size, 8)}
        assert {r.found for r in rows.values()} == {8}, "none is refused"
        assert rows["clean"].largest_px <= 0.015
        assert rows["slope"].largest_px <= 0.02
        assert rows["noise"].rms_px <= 0.015
        assert rows["noise"].largest_px <= 0.05
        assert rows["copper"].largest_px <= 0.1
        assert 0.5 * rows["noise"].rms_px < rows["noise"].said_px < 3 * rows["noise"].rms_px
        assert rows["noise"].rms_px < (rows["noise"].paper_rms_px or math.inf)


def test_the_bound_is_that_of_a_straight_edge() -> None:
    """Edges of contrast C, blur σ and length L under noise s fix a place across to s·√(2√π·σ / (C²·L))."""
    picture = paint("square", True, 60.0, np.array([60.0, 60.0]), 121, False)
    blur = math.hypot(0.6, 0.29)
    expected = 2 * math.sqrt(2 * math.sqrt(math.pi) * blur / (150**2 * 120))
    assert bound_px(picture, np.full_like(picture, 4.0)) == pytest.approx(expected, rel=0.1)


def test_noise_is_as_it_claims() -> None:
    plain = paint("circle", True, 20.0, np.array([30.0, 30.0]), 61, False)
    g = np.random.default_rng(1)
    ratio = []
    for _ in range(40):
        image, variance = film(plain, "noise", g)
        corner = image[:15, :15].astype(float)
        ratio.append(corner.var() / variance[:15, :15].mean())
    assert np.mean(ratio) == pytest.approx(1.0, abs=0.1)


def test_the_table_and_the_drawing_show_every_kind() -> None:
    rows = tuple(r for shape in SHAPES for r in _rows(shape, True, 16.0, 2))
    figures = MarkFigures(rows, (_curve("circle", 4),), "demo", 0.25)
    table = list(figures.lines())
    assert len(table) == 2 + len(SHAPES)
    assert len({line.count("|") for line in table}) == 1
    assert any(line.startswith("| light diamond | 16 |") for line in table)
    document: dict[str, Any] = figures.document()
    assert document["rows"][0]["condition"] == "clean"
    told = Curve("square", 16.0, (-0.5, 0.0, 0.5), (0.001, math.nan, -0.001), (None, 0.5, -0.5))
    drawn = replace(figures, curves=(*figures.curves, told)).plot()
    assert drawn.startswith("<svg xmlns=")
    assert drawn.count("<polyline") == 6
    assert "nan" not in drawn
