"""Draw the bias of a measured position over the sub-pixel fraction of the true position, as SVG."""

from __future__ import annotations

import math
from collections.abc import Sequence
from dataclasses import dataclass

from vaoi_station.reporting.drawing.svg import drawing, polyline, tag, text

_WIDTH, _PANEL, _LEFT, _TOP, _GAP = 640.0, 120.0, 64.0, 34.0, 26.0
_RANGE_PX = 0.02
"""Largest error on the axis of a panel, in both directions; larger errors are drawn at the panel's edge."""
_OURS, _THEIRS, _AXIS, _INK = "#0b6e4f", "#c0392b", "#bbbbbb", "#222222"


@dataclass(frozen=True)
class Panel:
    """One panel of the plot: the errors of two methods over the sub-pixel fraction of the true position.

    Attributes:
        name: caption of the panel.
        fraction: sub-pixel fractions of the true position, −0.5 … 0.5.
        ours_px: error of our method at each fraction; NaN where it found nothing.
        theirs_px: error of the other method at each fraction; None where it found nothing.
    """

    name: str
    fraction: Sequence[float]
    ours_px: Sequence[float]
    theirs_px: Sequence[float | None]


def draw_bias_panels(panels: Sequence[Panel], title: str, methods: tuple[str, str]) -> str:
    """Draw panels one below the other as SVG: this station's method in green, the other method in red.

    Args:
        panels: the panels, from top to bottom.
        title: one line above the panels.
        methods: names of our method and of the other one.
    """
    height = _TOP + len(panels) * (_PANEL + _GAP) + 20
    drawn = [part for n, panel in enumerate(panels) for part in _panel(panel, _TOP + n * (_PANEL + _GAP))]
    key = [
        tag("text", text(title), x=_LEFT, y=16.0, font_size=12, fill=_INK),
        tag("text", text(methods[0]), x=_WIDTH - 150, y=16.0, font_size=12, fill=_OURS),
        tag("text", text(methods[1]), x=_WIDTH - 100, y=16.0, font_size=12, fill=_THEIRS),
    ]
    ground = tag("rect", x=0.0, y=0.0, width=_WIDTH, height=height, fill="#ffffff")
    # A separate SVG file needs the namespace. Inside an HTML page it is not needed, so `drawing` leaves it out.
    return drawing(_WIDTH, height, ground, *key, *drawn, label="Bias over the sub-pixel fraction").replace(
        "<svg", '<svg xmlns="http://www.w3.org/2000/svg" font-family="sans-serif"', 1
    )


def _panel(panel: Panel, top: float) -> list[str]:
    right, middle = _WIDTH - 16, top + _PANEL / 2
    scale = _PANEL / 2 / _RANGE_PX

    def at(fraction: float, error: float) -> tuple[float, float]:
        return _LEFT + (fraction + 0.5) * (right - _LEFT), middle - max(min(error, _RANGE_PX), -_RANGE_PX) * scale

    out = [tag("rect", x=_LEFT, y=top, width=right - _LEFT, height=_PANEL, fill="none", stroke=_AXIS)]
    out.append(polyline([at(-0.5, 0), at(0.5, 0)], stroke=_AXIS))
    for error in (-_RANGE_PX, 0.0, _RANGE_PX):
        y = at(0, error)[1] + 4
        out.append(tag("text", text(f"{error:+.2f}"), x=_LEFT - 6, y=y, font_size=11, text_anchor="end", fill=_INK))
    out.append(tag("text", text(panel.name), x=_LEFT + 6, y=top + 15, font_size=12, fill=_INK))
    # Fractions at which a method found nothing are left out; the polyline joins their neighbours.
    theirs = [at(f, e) for f, e in zip(panel.fraction, panel.theirs_px, strict=True) if e is not None]
    ours = [at(f, e) for f, e in zip(panel.fraction, panel.ours_px, strict=True) if math.isfinite(e)]
    out.append(polyline(theirs, stroke=_THEIRS, stroke_width=1.2, stroke_dasharray="4 3"))
    out.append(polyline(ours, stroke=_OURS, stroke_width=2))
    return out
