"""Accuracy of the detection of marks, as `vaoi bench --marks` measures it."""

from __future__ import annotations

import json
import math
from typing import Any

import cv2
import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.benchmarks.boards import BenchmarkBoard
from vaoi_station.benchmarks.marks import (
    MarkFigures,
    cramer_rao_px,
    measure_mark_kind,
    measure_marks,
    render_mark,
)
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
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


@pytest.mark.parametrize("positions", [0, 1])
def test_table_and_document_exist_without_marks(positions: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """No mark was rendered; or one, and no method found it."""

    def refuse(*_: Any, **__: Any) -> Failure:
        return Failure("no mark")

    monkeypatch.setattr("vaoi_station.benchmarks.marks.locate_mark", refuse)
    monkeypatch.setattr("vaoi_station.benchmarks.marks.locate_by_centre_of_gravity", refuse)
    rows = tuple(measure_mark_kind("circle", True, 16.0, positions))
    figures = MarkFigures(rows, "demo", 0.25)
    assert {(r.found, r.of) for r in rows} == {(0, positions)}
    *_, line = figures.lines()
    assert "– / – (–)" in line
    assert "nan" not in line
    document = figures.document()
    assert (document["rows"][0]["rms_px"], document["rows"][0]["bias_px"]) == (None, [None, None])
    json.dumps(document, allow_nan=False)


def test_whole_benchmark_restores_the_number_of_threads(small_board: BenchmarkBoard) -> None:
    threads = cv2.getNumThreads()
    figures = measure_marks(positions=1, board=small_board, sizes_px=(16.0,))
    assert cv2.getNumThreads() == threads
    assert len(figures.rows) == len(SHAPES) * 2 * 4
    assert figures.document()["material"] == "small"
    assert figures.whole_frame_ms > 0


DARK, LIGHT = 50.0, 200.0
AREAS: dict[Shape, float] = {"circle": math.pi / 4, "square": 1.0, "diamond": 0.5, "cross": 7 / 16}
"""Area over the square of the size; the arms of a cross are a quarter of its size wide."""


def coverage(shape: Shape, size_px: float, at: Floats, side: int) -> Floats:
    return (render_mark(shape, True, size_px, at, side, False) - DARK) / (LIGHT - DARK)


@pytest.mark.parametrize("shape", AREAS)
@given(x=st.floats(-0.5, 0.5), y=st.floats(-0.5, 0.5), size_px=st.floats(12, 40))
def test_mark_has_its_area_and_its_centre_of_gravity(shape: Shape, x: float, y: float, size_px: float) -> None:
    at = np.array([40 + x, 40 + y])
    share = coverage(shape, size_px, at, 81)
    weight = share.sum()
    assert weight == pytest.approx(AREAS[shape] * size_px**2, rel=0.02)
    pixels = np.arange(81)
    assert (share.sum(0) @ pixels / weight, share.sum(1) @ pixels / weight) == pytest.approx(tuple(at), abs=2e-3)


def test_bound_is_that_of_straight_edges() -> None:
    """Edges of contrast C, blur σ and total length L under noise s fix a centre to s·√(2√π·σ / (C²·L))."""
    image = render_mark("square", True, 60.0, np.array([60.0, 60.0]), 121, False)
    blur = math.hypot(0.6, 0.29)
    expected = 2 * math.sqrt(2 * math.sqrt(math.pi) * blur / (150**2 * 120))
    assert cramer_rao_px(image, np.full_like(image, 4.0)) == pytest.approx(expected, rel=0.1)
