"""Pins over time, and how far from their wanted times the edges were: one drawing."""

from __future__ import annotations

import math
from collections import Counter
from collections.abc import Iterable, Mapping, Sequence
from dataclasses import dataclass

from vaoi_station.reporting.drawing import drawing, label, polyline, tag, ticks

_PINS = {
    "PB0": "light barrier",
    "PB1": "camera trigger",
    "PB2": "LED gate",
    "PD4": "LED channel 1",
    "PD5": "LED channel 2",
    "PD6": "LED channel 3",
    "PD7": "LED channel 4",
}
_WIDTH, _LEFT, _LANE, _HIGH = 960.0, 150.0, 30.0, 18.0
_INK, _AXIS, _WANTED = "#222222", "#bbbbbb", "#c0392b"
_COLOURS = ("#0b6e4f", "#1f4e8c")
_HISTOGRAM = 84.0
_REACH_US = 1.1
"""Half the width of a histogram."""
_STEP_US = 1 / 16
"""The emulator's clock."""


@dataclass(frozen=True)
class Trace:
    """What one board did to the pins: (µs after the barrier's edge, pin, level) in order."""

    edges: tuple[tuple[float, str, int], ...]


@dataclass(frozen=True)
class _Axis:
    """µs → x of the drawing."""

    low_us: float
    high_us: float
    unit_us: float
    """µs per unit of the ticks' numbers."""
    unit: str
    left: float = _LEFT
    right: float = _WIDTH - 20

    def __call__(self, us: float) -> float:
        share = (min(max(us, self.low_us), self.high_us) - self.low_us) / (self.high_us - self.low_us)
        return self.left + share * (self.right - self.left)


def draw(trace: Trace, series: Mapping[str, Mapping[str, Sequence[float]]]) -> str:
    """SVG: the whole passage, its first pulse magnified, and a histogram of every figure.

    Args:
        trace: of one board.
        series: serial load → figure → deviations from the wanted value, µs.
    """
    first_us = next(us for us, pin, level in trace.edges if pin == "PB1" and level)
    parts = [tag("rect", x=0.0, y=0.0, width=_WIDTH, height=1000.0, fill="#ffffff")]
    top = 24.0
    parts.append(label(_LEFT, top, "One board: pins over time after the barrier's edge", font_size=14, fill=_INK))
    top = _lanes(parts, trace, _Axis(-20e3, 400e3, 1e3, "ms"), top + 14)
    words = "Its first row: the channel is selected beforehand, trigger and gate rise in one clock cycle"
    parts.append(label(_LEFT, top + 34, words, font_size=14, fill=_INK))
    around = _Axis(first_us - 2300, first_us + 500, 1.0, "µs")
    top = _lanes(parts, trace, around, top + 48, tuple(_PINS)[1:5])
    words = "Measured minus wanted, µs: how often (logarithmic in height)"
    parts.append(label(_LEFT, top + 34, words, font_size=14, fill=_INK))
    for n, name in enumerate(series):
        parts.append(
            label(_WIDTH - 20 - 210 * (1 - n), top + 34, name, font_size=12, fill=_COLOURS[n], text_anchor="end")
        )
    top = _histograms(parts, series, top + 48)
    parts[0] = tag("rect", x=0.0, y=0.0, width=_WIDTH, height=top, fill="#ffffff")
    svg = drawing(_WIDTH, top, *parts, label="Timing of the firmware on the emulated chip")
    return svg.replace("<svg", '<svg xmlns="http://www.w3.org/2000/svg" font-family="sans-serif"', 1) + "\n"


def _lanes(parts: list[str], trace: Trace, axis: _Axis, top: float, pins: Sequence[str] = tuple(_PINS)) -> float:
    """One lane per pin, and the scale below; returns where they end."""
    bottom = top + len(pins) * _LANE
    for us in ticks(axis.low_us / axis.unit_us, axis.high_us / axis.unit_us, 8):
        x = axis(us * axis.unit_us)
        parts.append(polyline([(x, top), (x, bottom)], stroke="#eeeeee"))
        parts.append(label(x, bottom + 14, f"{us:g} {axis.unit}", font_size=11, fill=_INK, text_anchor="middle"))
    for n, pin in enumerate(pins):
        base = top + (n + 1) * _LANE - 5
        parts.append(label(_LEFT - 10, base - 3, f"{_PINS[pin]}, {pin}", font_size=12, fill=_INK, text_anchor="end"))
        line = list(_staircase(((us, level) for us, name, level in trace.edges if name == pin), axis, base))
        parts.append(polyline(line, stroke=_COLOURS[0], stroke_width=1.4))
    return bottom + 14


def _staircase(edges: Iterable[tuple[float, int]], axis: _Axis, base: float) -> Iterable[tuple[float, float]]:
    level = 0
    yield axis(axis.low_us), base
    for us, new in edges:
        if us < axis.low_us:
            level = new
            continue
        if us > axis.high_us:
            break
        yield axis(us), base - level * _HIGH
        level = new
        yield axis(us), base - level * _HIGH
    yield axis(axis.high_us), base - level * _HIGH


def _histograms(parts: list[str], series: Mapping[str, Mapping[str, Sequence[float]]], top: float) -> float:
    figures = list(next(iter(series.values())))
    wide = (_WIDTH - 40) / len(figures)
    bottom = top + _HISTOGRAM + 20
    for n, figure in enumerate(figures):
        left = 20 + n * wide
        axis = _Axis(-_REACH_US, _REACH_US, 1.0, "µs", left + 8, left + wide - 8)
        parts.append(label(left + wide / 2, top + 12, figure, font_size=12, fill=_INK, text_anchor="middle"))
        parts.append(polyline([(axis(0), top + 18), (axis(0), bottom)], stroke=_WANTED, stroke_dasharray="3 3"))
        parts.append(polyline([(axis.left, bottom), (axis.right, bottom)], stroke=_AXIS))
        for us in (-1, -0.5, 0, 0.5, 1):
            parts.append(
                label(axis(us), bottom + 14, f"{us:+g}" if us else "0", font_size=11, fill=_INK, text_anchor="middle")
            )
        for k, rows in enumerate(series.values()):
            parts += _bars(rows[figure], axis, bottom, k)
    return bottom + 26


def _bars(values: Sequence[float], axis: _Axis, bottom: float, k: int) -> list[str]:
    """A line for every clock cycle that occurs; both loads side by side."""
    counts = Counter(round(value / _STEP_US) for value in values)
    full = 1 + math.log10(max(counts.values()))
    out = []
    for cycles, count in sorted(counts.items()):
        x = axis(cycles * _STEP_US) + (k - 0.5) * 3
        high = (1 + math.log10(count)) / full * (_HISTOGRAM - 10)
        out.append(polyline([(x, bottom), (x, bottom - high)], stroke=_COLOURS[k], stroke_width=2.4))
    return out
