"""Measure accuracy and speed of the detection of marks; compare with the paper's method and the Cramér-Rao bound."""

from __future__ import annotations

import math
import statistics
import time
from collections.abc import Iterator, Sequence
from dataclasses import asdict, dataclass
from itertools import product
from typing import Any, Literal, get_args

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.benchmarks.boards import BenchmarkBoard, board_from_twin, one_thread
from vaoi_station.benchmarks.tables import json_document, number
from vaoi_station.geometry.robust import Failure
from vaoi_station.geometry.transforms import Floats
from vaoi_station.marks import Mark, locate_mark
from vaoi_station.marks.centre_of_gravity import locate_by_centre_of_gravity
from vaoi_station.marks.mark_shape import Shape
from vaoi_station.stitching.board.fiducials import detect_marks
from vaoi_station.stitching.matching.evidence import Task
from vaoi_station.stitching.matching.frames import PreparedFrame

SIZES_PX = (12.0, 16.0, 20.0, 24.0, 32.0, 40.0)
_OFF_SHARE = 0.15
"""Largest error of the predicted centre along each axis, as a share of the mark's size."""


@dataclass(frozen=True)
class MarkErrors:
    """Errors of one kind of mark under one imaging condition; rms and bias are per axis, NaN if no mark was found."""

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
    """Standard deviation that the detector states, rms over all marks."""
    bound_px: float
    paper_rms_px: float | None
    """Rms error of the paper's method; None if it found no mark."""
    ms: float


@dataclass(frozen=True)
class MarkFigures:
    """The figures of `vaoi bench --marks`."""

    rows: tuple[MarkErrors, ...]
    material: str
    whole_frame_ms: float
    """CPU time to search a whole frame for marks, without the reduction to quarter size; median over a board."""

    def document(self) -> dict[str, Any]:
        """Return all figures of the benchmark as a dictionary for JSON."""
        document: dict[str, Any] = json_document(asdict(self))
        return document

    def lines(self) -> Iterator[str]:
        """Yield the lines of a Markdown table: one row per kind and size, one column per condition."""
        yield "| mark | size, px | " + " | ".join(f"{c}: rms / largest (paper)" for c in CONDITIONS) + " | bound | ms |"
        yield "|---|---|" + "---|" * (len(CONDITIONS) + 2)
        keys = dict.fromkeys((r.shape, r.light, r.size_px) for r in self.rows)
        for shape, light, size in keys:
            rows = {r.condition: r for r in self.rows if (r.shape, r.light, r.size_px) == (shape, light, size)}
            cells = " | ".join(_cell(rows[c]) for c in CONDITIONS)
            ms = statistics.median(r.ms for r in rows.values())
            kind = f"{'light' if light else 'dark'} {'disc' if shape == 'circle' else shape}"
            yield f"| {kind} | {size:g} | {cells} | {number(rows['noise'].bound_px, 4)} | {number(ms, 2)} |"


@one_thread()
def measure_marks(
    positions: int = 24, board: BenchmarkBoard | None = None, sizes_px: Sequence[float] = SIZES_PX
) -> MarkFigures:
    """Measure marks of all kinds at random sub-pixel positions, the same at each call; search frames of a board."""
    kinds = product(get_args(Shape), (True, False), sizes_px)
    rows = [row for shape, light, size in kinds for row in measure_mark_kind(shape, light, size, positions)]
    searched = board or board_from_twin()
    return MarkFigures(tuple(rows), searched.name, _whole_frame_ms(searched))


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


def _whole_frame_ms(board: BenchmarkBoard) -> float:
    times = []
    for key, pixels in board.frames.items():
        frame = PreparedFrame(pixels)
        # Links also need the quarter-size image, so it does not count as a cost of the marks.
        _ = frame.reduced(4)
        camera = board.setup.cameras[key[0]]
        start = time.process_time()
        detect_marks(Task("marks", key), frame, camera, board.board_type)
        times.append((time.process_time() - start) * 1e3)
    return _median(times, 3)


def _rms(values: Floats) -> float:
    """Compute the root mean square, rounded to 5 decimals; NaN without values."""
    return round(float(np.sqrt(np.mean(np.square(values)))), 5) if values.size else math.nan


def _median(values: Sequence[float], decimals: int) -> float:
    """Compute the median, rounded; NaN without values."""
    return round(statistics.median(values), decimals) if values else math.nan


def _cell(row: MarkErrors) -> str:
    missed = "" if row.found == row.of else f", {row.of - row.found} refused"
    return f"{number(row.rms_px, 4)} / {number(row.largest_px, 3)} ({number(row.paper_rms_px, 3)}){missed}"


Condition = Literal["clean", "noise", "slope", "copper"]
CONDITIONS: dict[Condition, str] = {
    "clean": "blur of 0.6 px, rounded to grey levels",
    "noise": "with shot noise (0.03 per level), read noise of 1.5 levels, and vignetting of 25 % to the frame's corner",
    "slope": "clean, brighter by 0.3 % per px",
    "copper": "clean, with a track as bright as the mark 0.3 sizes from its edge, on one side",
}
_FINE = 5
_LIGHT, _DARK = 200.0, 50.0
"""Grey levels of a light mark and its ground; for a dark mark, they are exchanged."""
_SHOT, _READ = 0.03, 1.5
_SLOPE = 0.003
_VIGNETTE, _FRAME_PX = 0.25, (1392, 1040)


def render_mark(shape: Shape, light: bool, size_px: float, at: Floats, side: int, copper: bool) -> Floats:
    """Render a mark with its centre at `at` (2,), px, blurred by 0.6 px; return (side, side) grey levels."""
    # Centres of the samples; pixel 0 reaches from −0.5 to 0.5 (docs/conventions.md).
    fine = (np.arange(side * _FINE) + 0.5) / _FINE - 0.5
    cover = _covered(shape, fine[None] - at[0], fine[:, None] - at[1], size_px)
    if copper:
        track = fine - at[0] - 0.8 * size_px
        cover = np.maximum(cover, _within(np.abs(track - 0.25 * size_px) - 0.25 * size_px)[None])
    smooth = cv2.GaussianBlur(cover, (0, 0), 0.6 * _FINE)
    share = smooth.reshape(side, _FINE, side, _FINE).mean((1, 3))
    return np.asarray(_DARK + (_LIGHT - _DARK) * (share if light else 1 - share))


def apply_condition(image: Floats, condition: Condition, g: np.random.Generator) -> tuple[NDArray[np.uint8], Floats]:
    """Return the image as a camera takes it under an imaging condition, and the noise variance of each pixel."""
    side = len(image)
    at = np.arange(side) - (side - 1) / 2
    if condition == "slope":
        image = image * (1 + _SLOPE * at)[None]
    # Rounding to whole grey levels has a variance of 1/12.
    variance = np.full_like(image, 1 / 12)
    if condition == "noise":
        # The mark lies anywhere in a full frame, which decides how much vignetting it has.
        place = g.uniform(-0.5, 0.5, 2) * (np.array(_FRAME_PX) - side)
        u, v = (2 * (at + p) / extent for p, extent in zip(place, _FRAME_PX, strict=True))
        image = image * (1 - _VIGNETTE * (u[None] ** 2 + v[:, None] ** 2) / 2)
        variance = variance + _SHOT * image + _READ**2
        image = image + g.normal(size=image.shape) * np.sqrt(variance)
    return np.clip(np.rint(image), 0, 255).astype(np.uint8), variance


def cramer_rao_px(image: Floats, variance: Floats) -> float:
    """Return the Cramér-Rao bound of a mark's centre, px per axis, from its grey levels and their variances."""
    waves = 2j * np.pi * np.fft.fftfreq(len(image))
    # Derivatives come from the Fourier transform: differences of neighbouring pixels would make edges softer.
    spectrum = np.fft.fft2(image)
    gx, gy = (np.fft.ifft2(spectrum * way).real for way in (waves[None], waves[:, None]))
    information = np.array([[(a * b / variance).sum() for b in (gx, gy)] for a in (gx, gy)])
    return float(math.sqrt(np.trace(np.linalg.inv(information)) / 2))


def _covered(shape: Shape, x: Floats, y: Floats, size: float) -> Floats:
    """Return the share of each sample at (x, y), px, that a shape at the origin covers."""
    x, y, r = np.abs(x), np.abs(y), size / 2
    if shape == "circle":
        return _within(np.hypot(x, y) - r)
    if shape == "square":
        return _within(x - r) * _within(y - r)
    if shape == "diamond":
        return _within_diagonal((x + y - r) * _FINE)
    return np.maximum(_within(x - r) * _within(y - r / 4), _within(x - r / 4) * _within(y - r))


def _within_diagonal(cells: Floats) -> Floats:
    """Return the share of a sample inside an outline at 45°. `cells` is its distance along an axis, in samples."""
    # Integral of the triangular width of a unit square along its diagonal.
    t = np.clip(cells, -1, 1)
    return np.asarray(np.where(t < 0, 1 - (1 + t) ** 2 / 2, (1 - t) ** 2 / 2))


def _within(beyond: Floats) -> Floats:
    """Return the share of a sample inside an outline, if the sample's centre lies `beyond` px outside the outline."""
    return np.asarray(np.clip(0.5 - beyond * _FINE, 0, 1))
