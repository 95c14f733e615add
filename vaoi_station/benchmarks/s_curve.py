"""The S-curve as a drawing: how the place of a mark errs over the fraction of a pixel it lies at."""

from __future__ import annotations

import math
from collections.abc import Sequence

from vaoi_station.benchmarks.marks import Curve
from vaoi_station.reporting.svg import drawing, polyline, tag, text

_WIDTH, _PANEL, _LEFT, _TOP, _GAP = 640.0, 120.0, 64.0, 34.0, 26.0
_RANGE_PX = 0.02
"""A panel shows errors up to so many px to both sides; the paper's way leaves it."""
_OURS, _PAPERS, _AXIS, _INK = "#0b6e4f", "#c0392b", "#bbbbbb", "#222222"


def draw(curves: Sequence[Curve]) -> str:
    """SVG, one panel per shape: ours in green, the paper's way in red."""
    height = _TOP + len(curves) * (_PANEL + _GAP) + 20
    panels = [part for n, curve in enumerate(curves) for part in _panel(curve, _TOP + n * (_PANEL + _GAP))]
    size = curves[0].size_px if curves else 0.0
    head = f"error along x, px, over the fraction of a pixel; light marks of {size:g} px, clean"
    key = [
        tag("text", text(head), x=_LEFT, y=16.0, font_size=12, fill=_INK),
        tag("text", text("fitted"), x=_WIDTH - 130, y=16.0, font_size=12, fill=_OURS),
        tag("text", text("paper's way"), x=_WIDTH - 80, y=16.0, font_size=12, fill=_PAPERS),
    ]
    ground = tag("rect", x=0.0, y=0.0, width=_WIDTH, height=height, fill="#ffffff")
    label = "Bias of marks over the sub-pixel fraction"
    return drawing(_WIDTH, height, ground, *key, *panels, label=label).replace(
        "<svg", '<svg xmlns="http://www.w3.org/2000/svg" font-family="sans-serif"', 1
    )


def _panel(curve: Curve, top: float) -> list[str]:
    right, middle = _WIDTH - 16, top + _PANEL / 2
    scale = _PANEL / 2 / _RANGE_PX

    def at(fraction: float, error: float) -> tuple[float, float]:
        return _LEFT + (fraction + 0.5) * (right - _LEFT), middle - max(min(error, _RANGE_PX), -_RANGE_PX) * scale

    name = "disc" if curve.shape == "circle" else curve.shape
    out = [tag("rect", x=_LEFT, y=top, width=right - _LEFT, height=_PANEL, fill="none", stroke=_AXIS)]
    out.append(polyline([at(-0.5, 0), at(0.5, 0)], stroke=_AXIS))
    for error in (-_RANGE_PX, 0.0, _RANGE_PX):
        y = at(0, error)[1] + 4
        out.append(tag("text", text(f"{error:+.2f}"), x=_LEFT - 6, y=y, font_size=11, text_anchor="end", fill=_INK))
    out.append(tag("text", text(name), x=_LEFT + 6, y=top + 15, font_size=12, fill=_INK))
    theirs = [at(f, e) for f, e in zip(curve.fraction, curve.paper_px, strict=True) if e is not None]
    ours = [at(f, e) for f, e in zip(curve.fraction, curve.error_px, strict=True) if math.isfinite(e)]
    out.append(polyline(theirs, stroke=_PAPERS, stroke_width=1.2, stroke_dasharray="4 3"))
    out.append(polyline(ours, stroke=_OURS, stroke_width=2))
    return out
