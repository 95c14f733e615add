"""Draw real errors over predicted errors, one point per run, and the distribution of normalised errors, as SVG."""

from __future__ import annotations

import math
from collections.abc import Sequence

import numpy as np

from vaoi_station.benchmarks.accuracy.consistency import RunErrors
from vaoi_station.reporting.drawing.svg import drawing, label, polyline, tag

_SIDE_PX, _LEFT_PX, _TOP_PX, _BETWEEN_PX = 300.0, 56.0, 24.0, 76.0
_INK, _FAINT, _TWIN, _RECORDED = "#333333", "#cccccc", "#34608d", "#b0552e"
_TICKS_PX = (0.003, 0.01, 0.03, 0.1)
_LONGEST = 4.0
"""End of the axis of normalised lengths, in standard deviations."""


def draw_consistency(twin: Sequence[RunErrors], recorded: Sequence[RunErrors]) -> str:
    """Draw two panels: real rms of each run over its predicted rms, and the distribution of normalised lengths."""
    groups = [g for g in ((twin, _TWIN, "twin"), (recorded, _RECORDED, "recordings")) if len(g[0])]
    second = _LEFT_PX + _SIDE_PX + _BETWEEN_PX
    content = [*_frame(_LEFT_PX), *_frame(second), *_runs_axes(), *_lengths_axes(second)]
    for k, (runs, colour, name) in enumerate(groups):
        good = [r for r in runs if len(r.error_px)]
        content += [_point(r, colour) for r in good]
        content.append(_length_distribution(np.concatenate([r.distance for r in good]), second, colour))
        content.append(label(_LEFT_PX + 10, _TOP_PX + 18 + 16 * k, name, fill=colour, font_size=12))
    width, height = second + _SIDE_PX + 16, _TOP_PX + _SIDE_PX + 48
    body = tag("g", *content, font_family="sans-serif")
    # A separate SVG file needs the namespace. Inside an HTML page it is not needed, so `drawing` leaves it out.
    words = "Predicted and real error of component positions"
    return drawing(width, height, body, label=words).replace("<svg ", '<svg xmlns="http://www.w3.org/2000/svg" ', 1)


def _frame(left: float) -> list[str]:
    return [tag("rect", x=left, y=_TOP_PX, width=_SIDE_PX, height=_SIDE_PX, fill="none", stroke=_INK)]


def _log_position(px: float) -> float:
    """Return the position of a length on the logarithmic axes, from 0 to 1; longer or shorter lengths are clipped."""
    low, high = math.log(_TICKS_PX[0]), math.log(_TICKS_PX[-1])
    return min(max((math.log(max(px, 1e-9)) - low) / (high - low), 0.0), 1.0)


def _point(run: RunErrors, colour: str) -> str:
    x = _LEFT_PX + _log_position(run.predicted_rms_px) * _SIDE_PX
    y = _TOP_PX + (1 - _log_position(run.rms_px)) * _SIDE_PX
    words = f"{run.name}: predicted {run.predicted_rms_px:.4f} px, real {run.rms_px:.4f} px"
    return tag("circle", tag("title", words), cx=x, cy=y, r=3.5, fill=colour, fill_opacity=0.7)


def _runs_axes() -> list[str]:
    bottom = _TOP_PX + _SIDE_PX
    out = [polyline([(_LEFT_PX, bottom), (_LEFT_PX + _SIDE_PX, _TOP_PX)], stroke=_FAINT)]
    for px in _TICKS_PX:
        at = _log_position(px) * _SIDE_PX
        out.append(label(_LEFT_PX + at, bottom + 16, f"{px:g}", font_size=11, text_anchor="middle", fill=_INK))
        out.append(label(_LEFT_PX - 6, bottom - at + 4, f"{px:g}", font_size=11, text_anchor="end", fill=_INK))
    middle = _LEFT_PX + _SIDE_PX / 2
    out.append(label(middle, bottom + 36, "predicted rms of a run, px", font_size=12, text_anchor="middle", fill=_INK))
    out.append(label(_LEFT_PX, _TOP_PX - 8, "real rms, px", font_size=12, fill=_INK))
    return out


def _lengths_axes(left: float) -> list[str]:
    bottom = _TOP_PX + _SIDE_PX
    r = np.linspace(0, _LONGEST, 81)
    # Rayleigh distribution: lengths of normal errors in two dimensions.
    expected = 1 - np.exp(-(r**2) / 2)
    out = [polyline(_curve(r, expected, left), stroke=_INK, stroke_dasharray="4 3")]
    for k in range(int(_LONGEST) + 1):
        x = left + k / _LONGEST * _SIDE_PX
        out.append(label(x, bottom + 16, str(k), font_size=11, text_anchor="middle", fill=_INK))
    for share in (0.0, 0.5, 1.0):
        y = bottom - share * _SIDE_PX
        out.append(label(left - 6, y + 4, f"{share:g}", font_size=11, text_anchor="end", fill=_INK))
    middle = left + _SIDE_PX / 2
    out.append(label(middle, bottom + 36, "length of an error, sigma", font_size=12, text_anchor="middle", fill=_INK))
    out.append(label(left, _TOP_PX - 8, "share of views (dashed: normal errors)", font_size=12, fill=_INK))
    return out


def _length_distribution(distance: np.ndarray, left: float, colour: str) -> str:
    r = np.linspace(0, _LONGEST, 81)
    share = np.searchsorted(np.sort(distance), r, side="right") / len(distance)
    return polyline(_curve(r, share, left), stroke=colour, stroke_width=1.5)


def _curve(r: np.ndarray, share: np.ndarray, left: float) -> list[tuple[float, float]]:
    x, y = left + r / _LONGEST * _SIDE_PX, _TOP_PX + (1 - share) * _SIDE_PX
    return list(zip(x.tolist(), y.tolist(), strict=True))
