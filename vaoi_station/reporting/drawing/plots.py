"""Plot a quantity over the rows of a run, with the standard deviation at each row."""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import dataclass

import numpy as np

from vaoi_station.geometry.transforms import Floats
from vaoi_station.reporting.drawing.scales import number, ticks
from vaoi_station.reporting.drawing.svg import drawing, label, polygon, polyline, tag, title

_LEFT, _TOP, _BOTTOM = 58.0, 8.0, 26.0
# An axis never spans less than this: rounding noise of a constant must not look like a motion.
_LEAST_SPAN = 1e-3
_MOST_POINTS = 200
"""Largest number of rows for which points are drawn on the curve. More points would overlap."""


@dataclass(frozen=True)
class Plot:
    """The plot of one quantity over the rows of a run: its name, its unit, and the size of the drawing in px."""

    name: str
    unit: str
    width: float
    height: float = 190.0

    def draw(self, value: Floats, sigma: Floats, held: Sequence[bool]) -> str:
        """Draw values (m,) with standard deviations (m,) for m rows.

        Rows without evidence, where `held` (m,) is False, are drawn as hollow points.
        """
        # Only rows with evidence set the scale: the uncertainty of the others can exceed all motion, and is cut off.
        sure = np.array(held, dtype=bool) if any(held) else np.ones(len(value), dtype=bool)
        # Zero is always part of the axis, so that small and large motions can be distinguished at a glance.
        low = float(min((value - sigma)[sure].min(), value.min(), 0))
        high = float(max((value + sigma)[sure].max(), value.max(), 0))
        room = max((high - low) * 0.06, _LEAST_SPAN)
        low, high = low - room, high + room
        axes = self._axes(len(value), low, high)
        x = [self._x(j, len(value)) for j in range(len(value))]
        over, under = np.clip(value + sigma, low, high), np.clip(value - sigma, low, high)
        edge = [(a, self._y(float(b), low, high)) for a, b in zip(x, over, strict=True)]
        back = [(a, self._y(float(b), low, high)) for a, b in zip(x, under, strict=True)]
        band = polygon([*edge, *back[::-1]], fill="#34608d", fill_opacity=0.22)
        at = [(a, self._y(float(b), low, high)) for a, b in zip(x, value, strict=True)]
        curve = polyline(at, stroke="#22456b", stroke_width=1.5)
        points = (
            "".join(self._point(j, *p, value, sigma, held) for j, p in enumerate(at)) if len(at) <= _MOST_POINTS else ""
        )
        return drawing(self.width, self.height, axes, band, curve, points, label=f"{self.name} over rows")

    def _point(self, row: int, x: float, y: float, value: Floats, sigma: Floats, held: Sequence[bool]) -> str:
        words = f"row {row}: {number(float(value[row]))} ± {number(float(sigma[row]))} {self.unit}"
        if not held[row]:
            words += ", placed by the nominal motion alone"
        fill = "#22456b" if held[row] else "#fff"
        return tag("circle", title(words), cx=x, cy=y, r=3.2, fill=fill, stroke="#22456b", stroke_width=1.3)

    def _x(self, row: int, rows: int) -> float:
        share = row / (rows - 1) if rows > 1 else 0.5
        return _LEFT + 10 + share * (self.width - _LEFT - 24)

    def _y(self, value: float, low: float, high: float) -> float:
        return _TOP + (high - value) / (high - low) * (self.height - _TOP - _BOTTOM)

    def _axes(self, rows: int, low: float, high: float) -> str:
        out = []
        marks = ticks(low, high)
        step = marks[1] - marks[0] if len(marks) > 1 else 1.0
        digits = max(0, -int(np.floor(np.log10(step)))) if step < 1 else 0
        for v in marks:
            y = self._y(v, low, high)
            bold = abs(v) < step * 1e-6
            out.append(
                tag(
                    "line", x1=_LEFT, x2=self.width, y1=y, y2=y, stroke="#8a939b" if bold else "#e2e6e9", stroke_width=1
                )
            )
            out.append(label(_LEFT - 6, y + 4, number(v, digits), text_anchor="end", class_="faint"))
        every = max(1, round(ticks(0, max(rows - 1, 1), 12)[1]) if rows > 2 else 1)
        for j in range(0, rows, every):
            out.append(label(self._x(j, rows), self.height - 8, str(j), text_anchor="middle", class_="faint"))
        return "".join(out)
