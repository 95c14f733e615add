"""Design of a calibration board for an array: each camera sees enough marks within its mounting tolerance."""

from __future__ import annotations

import math
from dataclasses import dataclass
from typing import Literal

import numpy as np

from vaoi_station.calibration.artwork.drawing_elements import LABEL_MM
from vaoi_station.errors import InputError
from vaoi_station.files.calibrations import Layout, LayoutMark
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import Place

_GOLDEN = (math.sqrt(5) - 1) / 2
_JITTER = 0.12
"""Largest displacement of marks from the regular grid, as a share of their spacing.

Because of the displacements, no two views of the board look alike in any orientation.
"""
_MIN_DISTANCE = 1.6
"""Smallest distance of neighbouring marks divided by their size."""
_MICRON = 1e-3


@dataclass(frozen=True)
class ArrayDesign:
    """The input of the design: the camera array, and the number, size and polarity of the marks."""

    cameras: int
    pitch_mm: float
    """Distance between neighbouring cameras, along tester x."""
    field_mm: tuple[float, float]
    """Width and height of the field of view of one camera, mm."""
    columns: int = 5
    rows: int = 4
    """Number of marks in each view is `columns` across × `rows` down."""
    mark_mm: float = 2.0
    arm: float = 0.25
    tolerance_mm: float = 3.0
    """Accepted misplacement of cameras and board; marks keep this distance from the edge of a view."""
    border_mm: float = 5.0
    polarity: Literal["dark", "light"] = "dark"

    def __post_init__(self) -> None:
        low = {"pitch_mm": self.pitch_mm, "mark_mm": self.mark_mm, "field_mm": min(self.field_mm)}
        for key, value in low.items():
            if not (math.isfinite(value) and value > 0):
                raise InputError.field("calibration board", key, value, "above 0")
        if self.cameras < 1:
            raise InputError.field("calibration board", "cameras", self.cameras, "at least 1")
        if min(self.columns, self.rows) < 2:
            raise InputError.field(
                "calibration board", "marks per camera", f"{self.columns}×{self.rows}", "at least 2×2"
            )
        if not 0.05 <= self.arm <= 0.5:
            raise InputError.field("calibration board", "arm", self.arm, "0.05 … 0.5 of the mark")

    @property
    def span_mm(self) -> tuple[float, float]:
        """Width and height of the area of a view in which centres of marks may lie, mm."""
        lost = 2 * self.tolerance_mm + self.mark_mm
        return self.field_mm[0] - lost, self.field_mm[1] - lost


@dataclass(frozen=True, eq=False)
class Board:
    """A calibration board: its layout and its outline."""

    layout: Layout
    low_mm: tuple[float, float]
    """Smallest x and y of the board's outline, mm, in layout coordinates."""
    high_mm: tuple[float, float]
    camera_x_mm: tuple[float, ...]
    """x coordinate below each camera, mm."""

    @property
    def size_mm(self) -> tuple[float, float]:
        """Width and height of the board."""
        return self.high_mm[0] - self.low_mm[0], self.high_mm[1] - self.low_mm[1]

    @property
    def places_mm(self) -> Floats:
        """Centres of the marks, (k, 2) mm, in layout coordinates."""
        return np.array([(m.x, m.y) for m in self.layout.marks]) * self.layout.mm_per_unit


def design_board(design: ArrayDesign) -> Board:
    """Design a board on which each camera of an array sees its marks.

    The origin lies below camera 0. The x axis points along the array, and the y axis down in the frames.

    Raises:
        InputError: if the marks do not fit into a view.
    """
    x, y = _columns(design), _line(design.span_mm[1], design.rows)
    spacing = min(_least_gap(x), _least_gap(y))
    room = (1 - 2 * _JITTER) * spacing
    if room < _MIN_DISTANCE * design.mark_mm:
        raise InputError(
            f"{design.columns}×{design.rows} marks of {design.mark_mm:g} mm come within {room:.2f} mm of one another "
            f"in a view of {design.field_mm[0]:g}×{design.field_mm[1]:g} mm, the limit is "
            f"{_MIN_DISTANCE * design.mark_mm:.2f} mm.",
            action="Ask for fewer or smaller marks, or for less tolerance.",
        )
    # Coordinates are rounded to microns, so that all formats contain exactly the coordinates of layout.json.
    jitter = _JITTER * spacing
    places = [
        (round(u + jitter * dx, 3), round(v + jitter * dy, 3))
        for n, (u, v) in enumerate((u, v) for u in x for v in y)
        for dx, dy in [_off_grid(n)]
    ]
    mark = LayoutMark(size=design.mark_mm, width=round(design.mark_mm * design.arm, 6), polarity=design.polarity)
    layout = Layout(unit="mm", mark=mark, marks=tuple(Place(x=u, y=v) for u, v in places))
    width, height = design.field_mm
    edge = design.border_mm
    low = -width / 2 - edge, -height / 2 - edge
    high = (design.cameras - 1) * design.pitch_mm + width / 2 + edge, height / 2 + edge + LABEL_MM
    below = tuple(_micron(i * design.pitch_mm) for i in range(design.cameras))
    return Board(layout, (_micron(low[0]), _micron(low[1])), (_micron(high[0]), _micron(high[1])), below)


def _columns(design: ArrayDesign) -> Floats:
    """Compute the x coordinates of the columns of marks.

    They form one group below each camera, or one evenly spaced row if the views overlap too much for groups.
    """
    span = design.span_mm[0]
    group = _line(span, design.columns)
    gap = group[1] - group[0]
    if design.cameras == 1 or design.pitch_mm - span >= 0.5 * gap:
        return np.concatenate([i * design.pitch_mm + group for i in range(design.cameras)])
    step = span / design.columns
    length = (design.cameras - 1) * design.pitch_mm + span
    return np.asarray(-span / 2 + np.linspace(0, length, math.ceil(length / step) + 1))


def _line(span: float, count: int) -> Floats:
    """Return `count` evenly spaced positions. Marks may be displaced from them and still lie within the span."""
    if span <= 0:
        raise InputError(
            f"the view leaves {span:.1f} mm for marks after tolerance and mark size.",
            action="Ask for less tolerance or smaller marks.",
        )
    inner = span / (1 + 2 * _JITTER / (count - 1))
    return np.linspace(-inner / 2, inner / 2, count)


def _least_gap(line: Floats) -> float:
    return float(np.diff(line).min())


def _off_grid(n: int) -> tuple[float, float]:
    """Return how mark n is displaced from the grid: direction and relative size, as a vector of length ≤ 1."""
    # Multiples of irrational numbers modulo 1 have no pattern and, unlike random numbers, no seed or library version.
    angle, length = 2 * math.pi * ((n + 1) * _GOLDEN % 1.0), math.sqrt((n + 1) * _GOLDEN * math.e % 1.0)
    return length * math.cos(angle), length * math.sin(angle)


def _micron(value: float) -> float:
    return round(value / _MICRON) * _MICRON
