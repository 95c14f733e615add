"""How well and how fast marks are found: `vaoi bench --marks`, beside the paper's way and the Cramér-Rao bound."""

from __future__ import annotations

import statistics
import time
from collections.abc import Iterator
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any, get_args

import cv2
import numpy as np

from vaoi_station.benchmarks.frames import Material, of_twin
from vaoi_station.benchmarks.painted import CONDITIONS, Condition, bound_px, film, paint
from vaoi_station.benchmarks.s_curve import Panel, draw
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
"""How far from the truth the prediction is, in sizes, at the most along each axis."""
_S_CURVE_PX = 16.0


@dataclass(frozen=True)
class Row:
    """One kind of mark under one condition; rms and bias per axis, the baseline's rms beside."""

    shape: str
    light: bool
    size_px: float
    condition: str
    found: int
    of: int
    rms_px: float
    bias_px: tuple[float, float]
    largest_px: float
    said_px: float
    """Standard deviation that the marks claim, rms."""
    bound_px: float
    paper_rms_px: float | None
    """None where the paper's way found none of them."""
    ms: float
    """CPU time per mark in its predicted area, median."""


_NAMES = {"circle": "disc"}


@dataclass(frozen=True)
class Curve:
    """Error along x over the fraction of a pixel, px; light marks of one size, clean."""

    shape: str
    size_px: float
    fraction: tuple[float, ...]
    error_px: tuple[float, ...]
    paper_px: tuple[float | None, ...]


@dataclass(frozen=True)
class MarkFigures:
    """Everything `vaoi bench --marks` finds."""

    rows: tuple[Row, ...]
    curves: tuple[Curve, ...]
    material: str
    whole_frame_ms: float
    """CPU time of the search of a whole frame, median over a board; its quarter-size copy is there already."""

    def document(self) -> dict[str, Any]:
        """For JSON."""
        return asdict(self)

    def plot(self) -> str:
        """The curves as SVG."""
        panels = [Panel(_NAMES.get(c.shape, c.shape), c.fraction, c.error_px, c.paper_px) for c in self.curves]
        size = self.curves[0].size_px if self.curves else 0.0
        head = f"error along x, px, over the fraction of a pixel; light marks of {size:g} px, clean"
        return draw(panels, head, ("fitted", "paper's way"))

    def lines(self) -> Iterator[str]:
        """A table of Markdown: sizes go down, conditions across."""
        yield "| mark | size, px | " + " | ".join(f"{c}: rms / largest (paper)" for c in CONDITIONS) + " | bound | ms |"
        yield "|---|---|" + "---|" * (len(CONDITIONS) + 2)
        keys = dict.fromkeys((r.shape, r.light, r.size_px) for r in self.rows)
        for shape, light, size in keys:
            rows = {r.condition: r for r in self.rows if (r.shape, r.light, r.size_px) == (shape, light, size)}
            cells = " | ".join(_cell(rows[c]) for c in CONDITIONS)
            ms = statistics.median(r.ms for r in rows.values())
            kind = f"{'light' if light else 'dark'} {_NAMES.get(shape, shape)}"
            yield f"| {kind} | {size:g} | {cells} | {rows['noise'].bound_px:.4f} | {ms:.2f} |"


def measure_marks(positions: int = 24, material: Material | None = None) -> MarkFigures:
    """Measure marks of every kind at many sub-pixel positions, the same ones each time."""
    threads = cv2.getNumThreads()
    cv2.setNumThreads(1)
    try:
        kinds = list(product(get_args(Shape), (True, False), SIZES_PX))
        rows = [row for shape, light, size in kinds for row in _rows(shape, light, size, positions)]
        curves = tuple(_curve(shape) for shape in get_args(Shape))
        board = material or of_twin()
        return MarkFigures(tuple(rows), curves, board.name, _whole_frame_ms(board))
    finally:
        cv2.setNumThreads(threads)


def _rows(shape: Shape, light: bool, size_px: float, positions: int) -> Iterator[Row]:
    g, side = np.random.default_rng(7), 2 * round(1.5 * size_px + 12) + 1
    truths = (side - 1) / 2 + g.uniform(-0.5, 0.5, (positions, 2))
    plain = [paint(shape, light, size_px, at, side, False) for at in truths]
    tracked = [paint(shape, light, size_px, at, side, True) for at in truths]
    for condition in CONDITIONS:
        pictures = tracked if condition == "copper" else plain
        yield _row(shape, light, size_px, condition, list(zip(truths, pictures, strict=True)), g)


def _row(
    shape: Shape,
    light: bool,
    size_px: float,
    condition: Condition,
    painted: list[tuple[Floats, Floats]],
    g: np.random.Generator,
) -> Row:
    errors, claims, theirs, times, bounds = [], [], [], [], []
    for truth, picture in painted:
        image, variance = film(picture, condition, g)
        near = truth + g.uniform(-_OFF_SHARE, _OFF_SHARE, 2) * size_px
        start = time.process_time()
        mark = locate_mark(image, near, shape, size_px)
        times.append((time.process_time() - start) * 1e3)
        bounds.append(bound_px(picture, variance))
        if isinstance(mark, Mark):
            errors.append(mark.px - truth)
            claims.append(mark.sigma_px)
        other = locate_by_centre_of_gravity(image, near, shape, size_px, light=light, reach_px=0.2 * size_px)
        if not isinstance(other, Failure):
            theirs.append(other - truth)
    e = np.array(errors).reshape(-1, 2)
    return Row(
        shape,
        light,
        size_px,
        condition,
        len(errors),
        len(painted),
        _rms(e),
        (round(float(e[:, 0].mean()), 5), round(float(e[:, 1].mean()), 5)),
        round(float(np.hypot(*e.T).max()), 5),
        _rms(np.array(claims)),
        round(statistics.median(bounds), 5),
        _rms(np.array(theirs)) if theirs else None,
        round(statistics.median(times), 3),
    )


def _curve(shape: Shape, steps: int = 20) -> Curve:
    g, side = np.random.default_rng(3), 2 * round(1.5 * _S_CURVE_PX + 12) + 1
    fractions = np.arange(steps + 1) / steps - 0.5
    ours: list[float] = []
    theirs: list[float | None] = []
    for fraction in fractions:
        truth = np.array([(side - 1) / 2 + fraction, (side - 1) / 2 + 0.2])
        image, _ = film(paint(shape, True, _S_CURVE_PX, truth, side, False), "clean", g)
        mark = locate_mark(image, truth, shape, _S_CURVE_PX)
        ours.append(round(float(mark.px[0] - truth[0]), 5) if isinstance(mark, Mark) else float("nan"))
        other = locate_by_centre_of_gravity(image, truth, shape, _S_CURVE_PX, light=True, reach_px=4.0)
        theirs.append(None if isinstance(other, Failure) else round(float(other[0] - truth[0]), 5))
    return Curve(shape, _S_CURVE_PX, tuple(float(f) for f in fractions), tuple(ours), tuple(theirs))


def _whole_frame_ms(material: Material) -> float:
    times = []
    for key, pixels in material.frames.items():
        frame = PreparedFrame(pixels)
        _ = frame.quarter  # links want it anyway
        camera = material.setup.cameras[key[0]]
        start = time.process_time()
        detect_marks(Task("marks", key), frame, camera, material.board_type)
        times.append((time.process_time() - start) * 1e3)
    return round(statistics.median(times), 3)


def _rms(values: Floats) -> float:
    return round(float(np.sqrt(np.mean(np.square(values)))), 5)


def _cell(row: Row) -> str:
    missed = "" if row.found == row.of else f", {row.of - row.found} refused"
    paper = "–" if row.paper_rms_px is None else f"{row.paper_rms_px:.3f}"
    return f"{row.rms_px:.4f} / {row.largest_px:.3f} ({paper}){missed}"
