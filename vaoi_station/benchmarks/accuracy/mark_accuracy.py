"""Measure accuracy and speed of the detection of marks; compare with the paper's method and the Cramér-Rao bound."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any, get_args

import cv2
import numpy as np

from vaoi_station.benchmarks.accuracy.bias_plot import Panel, draw_bias_panels
from vaoi_station.benchmarks.accuracy.synthetic_marks import (
    CONDITIONS,
    Condition,
    apply_condition,
    cramer_rao_px,
    render_mark,
)
from vaoi_station.benchmarks.benchmark_board import BenchmarkBoard, board_from_twin
from vaoi_station.benchmarks.figure_formats import json_document, number
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.marks import Mark, locate_mark
from vaoi_station.marks.centre_of_gravity import locate_by_centre_of_gravity
from vaoi_station.marks.mark_shape import Shape
from vaoi_station.stitching.board.fiducial_detection import detect_marks
from vaoi_station.stitching.matching.evidence import Task
from vaoi_station.stitching.matching.prepared_frame import PreparedFrame

SIZES_PX = (12.0, 16.0, 20.0, 24.0, 32.0, 40.0)
_OFF_SHARE = 0.15
"""Largest error of the predicted centre along each axis, as a share of the mark's size."""
_S_CURVE_PX = 16.0
"""Size of the marks for which S-curves are measured: the error over the sub-pixel position, px."""


@dataclass(frozen=True)
class MarkErrors:
    """Errors of one kind of mark (shape, light or dark, size) under one imaging condition; rms and bias are per axis.

    A figure is NaN if no mark was rendered or found from which it could be computed.

    Attributes:
        shape: shape of the mark.
        light: whether the mark is lighter than its ground.
        size_px: size of the mark.
        condition: name of the imaging condition.
        found: number of marks that were found.
        of: number of marks that were rendered.
        largest_px: length of the longest error.
    """

    shape: str
    light: bool
    size_px: float
    condition: str
    found: int
    of: int
    rms_px: float
    bias_px: tuple[float, float]
    largest_px: float
    claimed_px: float
    """Standard deviation that the detector states, rms over all marks. Its key in JSON is `said_px`."""
    bound_px: float
    """Cramér-Rao bound of the error per axis, median over all marks."""
    paper_rms_px: float | None
    """Rms error of the paper's method; None if it found no mark."""
    ms: float
    """CPU time to locate one mark near its predicted centre, median."""


_NAMES = {"circle": "disc"}
"""Shape → its name in tables and plots, if that differs from the shape's own name."""


@dataclass(frozen=True)
class MarkCurve:
    """Error along x over the sub-pixel fraction of the true centre, for light marks of one size without noise."""

    shape: str
    size_px: float
    fraction: tuple[float, ...]
    error_px: tuple[float, ...]
    paper_px: tuple[float | None, ...]


@dataclass(frozen=True)
class MarkFigures:
    """The figures of `vaoi bench --marks`: errors of marks, and curves of bias."""

    rows: tuple[MarkErrors, ...]
    curves: tuple[MarkCurve, ...]
    material: str
    """Name of the board whose whole frames were searched."""
    whole_frame_ms: float
    """CPU time to search a whole frame for marks, without the reduction to quarter size; median over a board."""

    def document(self) -> dict[str, Any]:
        """Return all figures of the benchmark as a dictionary for JSON."""
        document: dict[str, Any] = json_document(asdict(self))
        # "said_px" is the key of the JSON file, which other programs may read.
        document["rows"] = [_renamed(row, "claimed_px", "said_px") for row in document["rows"]]
        return document

    def plot(self) -> str:
        """Draw the error of marks over their sub-pixel position as SVG."""
        panels = [Panel(_NAMES.get(c.shape, c.shape), c.fraction, c.error_px, c.paper_px) for c in self.curves]
        size = self.curves[0].size_px if self.curves else 0.0
        title = f"error along x, px, over the fraction of a pixel; light marks of {size:g} px, clean"
        return draw_bias_panels(panels, title, ("fitted", "paper"))

    def lines(self) -> Iterator[str]:
        """Yield the lines of a Markdown table: one row per kind and size, one column per condition."""
        yield "| mark | size, px | " + " | ".join(f"{c}: rms / largest (paper)" for c in CONDITIONS) + " | bound | ms |"
        yield "|---|---|" + "---|" * (len(CONDITIONS) + 2)
        keys = dict.fromkeys((r.shape, r.light, r.size_px) for r in self.rows)
        for shape, light, size in keys:
            rows = {r.condition: r for r in self.rows if (r.shape, r.light, r.size_px) == (shape, light, size)}
            cells = " | ".join(_cell(rows[c]) for c in CONDITIONS)
            ms = statistics.median(r.ms for r in rows.values())
            kind = f"{'light' if light else 'dark'} {_NAMES.get(shape, shape)}"
            yield f"| {kind} | {size:g} | {cells} | {number(rows['noise'].bound_px, 4)} | {number(ms, 2)} |"


def measure_marks(
    positions: int = 24, board: BenchmarkBoard | None = None, sizes_px: Sequence[float] = SIZES_PX
) -> MarkFigures:
    """Measure marks of all kinds at random sub-pixel positions, which are the same at each call.

    Args:
        positions: number of marks of each kind and condition.
        board: the board whose whole frames are searched; None: a board of the twin.
        sizes_px: sizes of the marks.
    """
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        kinds = list(product(get_args(Shape), (True, False), sizes_px))
        rows = [row for shape, light, size in kinds for row in measure_mark_kind(shape, light, size, positions)]
        curves = tuple(measure_s_curve(shape) for shape in get_args(Shape))
        searched = board or board_from_twin()
        return MarkFigures(tuple(rows), curves, searched.name, _whole_frame_ms(searched))
    finally:
        cv2.setNumThreads(threads)


def measure_mark_kind(shape: Shape, light: bool, size_px: float, positions: int) -> Iterator[MarkErrors]:
    """Measure one kind of mark at `positions` random positions; yield its errors under each imaging condition."""
    g, side = np.random.default_rng(7), 2 * round(1.5 * size_px + 12) + 1
    truths = (side - 1) / 2 + g.uniform(-0.5, 0.5, (positions, 2))
    plain = [render_mark(shape, light, size_px, at, side, False) for at in truths]
    tracked = [render_mark(shape, light, size_px, at, side, True) for at in truths]
    for condition in CONDITIONS:
        pictures = tracked if condition == "copper" else plain
        yield _errors((shape, light, size_px), condition, list(zip(truths, pictures, strict=True)), g)


def _errors(
    kind: tuple[Shape, bool, float],
    condition: Condition,
    rendered: list[tuple[Floats, Floats]],
    g: np.random.Generator,
) -> MarkErrors:
    shape, light, size_px = kind
    errors, claims, theirs, times, bounds = [], [], [], [], []
    for truth, picture in rendered:
        image, variance = apply_condition(picture, condition, g)
        near = truth + g.uniform(-_OFF_SHARE, _OFF_SHARE, 2) * size_px
        start = time.process_time()
        mark = locate_mark(image, near, shape, size_px)
        times.append((time.process_time() - start) * 1e3)
        bounds.append(cramer_rao_px(picture, variance))
        if isinstance(mark, Mark):
            errors.append(mark.px - truth)
            claims.append(mark.sigma_px)
        other = locate_by_centre_of_gravity(image, near, shape, size_px, light=light, reach_px=0.2 * size_px)
        if not isinstance(other, Failure):
            theirs.append(other - truth)
    e = np.array(errors).reshape(-1, 2)
    bias = (round(float(e[:, 0].mean()), 5), round(float(e[:, 1].mean()), 5)) if errors else (math.nan, math.nan)
    return MarkErrors(
        shape,
        light,
        size_px,
        condition,
        len(errors),
        len(rendered),
        _rms(e),
        bias,
        round(float(np.hypot(*e.T).max()), 5) if errors else math.nan,
        _rms(np.array(claims)),
        _median(bounds, 5),
        _rms(np.array(theirs)) if theirs else None,
        _median(times, 3),
    )


def measure_s_curve(shape: Shape, steps: int = 20) -> MarkCurve:
    """Measure the error along x of a mark that moves by one pixel in equal steps."""
    g, side = np.random.default_rng(3), 2 * round(1.5 * _S_CURVE_PX + 12) + 1
    fractions = np.arange(steps + 1) / steps - 0.5
    ours: list[float] = []
    theirs: list[float | None] = []
    for fraction in fractions:
        # The mark is off the pixel centre along y too, because at the centre its samples are symmetric, which is a
        # special case.
        truth = np.array([(side - 1) / 2 + fraction, (side - 1) / 2 + 0.2])
        image, _ = apply_condition(render_mark(shape, True, _S_CURVE_PX, truth, side, False), "clean", g)
        mark = locate_mark(image, truth, shape, _S_CURVE_PX)
        ours.append(round(float(mark.px[0] - truth[0]), 5) if isinstance(mark, Mark) else float("nan"))
        other = locate_by_centre_of_gravity(image, truth, shape, _S_CURVE_PX, light=True, reach_px=4.0)
        theirs.append(None if isinstance(other, Failure) else round(float(other[0] - truth[0]), 5))
    return MarkCurve(shape, _S_CURVE_PX, tuple(float(f) for f in fractions), tuple(ours), tuple(theirs))


def _whole_frame_ms(board: BenchmarkBoard) -> float:
    times = []
    for key, pixels in board.frames.items():
        frame = PreparedFrame(pixels)
        # Links also need the quarter-size image, so it does not count as a cost of the marks.
        _ = frame.quarter
        camera = board.setup.cameras[key[0]]
        start = time.process_time()
        detect_marks(Task("marks", key), frame, camera, board.board_type)
        times.append((time.process_time() - start) * 1e3)
    return _median(times, 3)


def _renamed(row: dict[str, Any], name: str, key: str) -> dict[str, Any]:
    """Return a copy of the dictionary `row` with the key `name` changed to `key`, in the same order."""
    return {key if k == name else k: v for k, v in row.items()}


def _rms(values: Floats) -> float:
    """Compute the root mean square, rounded to 5 decimals; NaN without values."""
    return round(float(np.sqrt(np.mean(np.square(values)))), 5) if values.size else math.nan


def _median(values: Sequence[float], decimals: int) -> float:
    """Compute the median, rounded; NaN without values."""
    return round(statistics.median(values), decimals) if values else math.nan


def _cell(row: MarkErrors) -> str:
    missed = "" if row.found == row.of else f", {row.of - row.found} refused"
    return f"{number(row.rms_px, 4)} / {number(row.largest_px, 3)} ({number(row.paper_rms_px, 3)}){missed}"
