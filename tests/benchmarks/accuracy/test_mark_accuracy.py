"""Accuracy of the detection of marks, as `vaoi bench --marks` measures it."""

from __future__ import annotations

import json
import math
from dataclasses import replace
from typing import Any

import cv2
import pytest

from vaoi_station.benchmarks.accuracy.mark_accuracy import (
    MarkCurve,
    MarkFigures,
    measure_mark_kind,
    measure_marks,
    measure_s_curve,
)
from vaoi_station.benchmarks.benchmark_board import BenchmarkBoard
from vaoi_station.geometry.robust import Failure
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


@pytest.mark.parametrize("shape", SHAPES)
def test_s_curve_stays_near_zero_over_the_whole_pixel(shape: Shape) -> None:
    curve = measure_s_curve(shape, steps=4)
    assert curve.fraction == (-0.5, -0.25, 0.0, 0.25, 0.5)
    assert max(abs(e) for e in curve.error_px) <= 0.015


def test_table_and_plot_contain_every_kind() -> None:
    rows = tuple(r for shape in SHAPES for r in measure_mark_kind(shape, True, 16.0, 2))
    figures = MarkFigures(rows, (measure_s_curve("circle", 4),), "demo", 0.25)
    table = list(figures.lines())
    assert len(table) == 2 + len(SHAPES)
    assert len({line.count("|") for line in table}) == 1
    assert any(line.startswith("| light diamond | 16 |") for line in table)
    document: dict[str, Any] = figures.document()
    assert document["rows"][0]["condition"] == "clean"
    assert document["rows"][0]["said_px"] == rows[0].claimed_px
    gaps = MarkCurve("square", 16.0, (-0.5, 0.0, 0.5), (0.001, math.nan, -0.001), (None, 0.5, -0.5))
    plot = replace(figures, curves=(*figures.curves, gaps)).plot()
    assert plot.startswith("<svg xmlns=")
    assert plot.count("<polyline") == 6
    assert "nan" not in plot


def test_refused_marks_are_counted_in_the_table() -> None:
    rows = [replace(r, found=1, paper_rms_px=None) for r in measure_mark_kind("circle", True, 16.0, 2)]
    *_, line = MarkFigures(tuple(rows), (), "demo", 0.25).lines()
    assert line.count("(–), 1 refused") == len(rows)


@pytest.mark.parametrize("positions", [0, 1])
def test_table_and_document_exist_without_marks(positions: int, monkeypatch: pytest.MonkeyPatch) -> None:
    """No mark was rendered; or one, and no method found it."""

    def refuse(*_: Any, **__: Any) -> Failure:
        return Failure("no mark")

    monkeypatch.setattr("vaoi_station.benchmarks.accuracy.mark_accuracy.locate_mark", refuse)
    monkeypatch.setattr("vaoi_station.benchmarks.accuracy.mark_accuracy.locate_by_centre_of_gravity", refuse)
    rows = tuple(measure_mark_kind("circle", True, 16.0, positions))
    figures = MarkFigures(rows, (measure_s_curve("circle", 1),), "demo", 0.25)
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
    assert [c.shape for c in figures.curves] == [r.shape for r in figures.rows[::8]]
    assert figures.document()["material"] == "small"
    assert figures.whole_frame_ms > 0
