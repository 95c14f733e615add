"""Choose round numbers for the axes of a plot, and colours that stand for numbers."""

from __future__ import annotations

import math
from dataclasses import dataclass

Colour = tuple[int, int, int]

RISING: tuple[Colour, ...] = ((62, 32, 98), (52, 94, 141), (38, 140, 136), (108, 186, 92), (250, 222, 60))
"""Colours from small to large values. Lightness rises monotonically, so that the scale is readable in grey too."""
ABOUT_ZERO: tuple[Colour, ...] = ((33, 78, 140), (126, 168, 206), (240, 240, 238), (222, 158, 120), (158, 58, 30))
"""Colours from negative to positive values; the middle colour stands for zero."""
GOOD: tuple[Colour, ...] = ((176, 58, 46), (214, 140, 50), (120, 160, 80), (24, 110, 80))
"""Colours for values from bad to good."""


@dataclass(frozen=True)
class Scale:
    """Colour scale for numbers from `low` to `high`. A number outside this range has the colour of the nearer end."""

    low: float
    high: float
    colours: tuple[Colour, ...] = RISING

    def __call__(self, value: float) -> str:
        """Return the colour of a number as `#rrggbb`."""
        span = self.high - self.low
        # A scale without span (all values equal) gives the middle colour.
        share = min(max((value - self.low) / span, 0.0), 1.0) if span > 0 else 0.5
        at = share * (len(self.colours) - 1)
        k = min(int(at), len(self.colours) - 2)
        mixed = (a + (b - a) * (at - k) for a, b in zip(self.colours[k], self.colours[k + 1], strict=True))
        return "#" + "".join(f"{round(c):02x}" for c in mixed)


def about_zero(values: list[float], least: float) -> Scale:
    """Return a scale symmetric about zero that covers all values. It extends at least from −`least` to +`least`."""
    reach = max([least, *(abs(v) for v in values)])
    return Scale(-reach, reach, ABOUT_ZERO)


def ticks(low: float, high: float, about: int = 5) -> list[float]:
    """Return about `about` round numbers between `low` and `high`, at which an axis is labelled."""
    span = high - low
    if not (math.isfinite(span) and span > 0):
        return [low]
    step = round_up(span / about)
    # The tolerance keeps a tick at the end of the range that rounding has moved outside.
    first = math.ceil(low / step - 1e-9)
    return [k * step for k in range(first, math.floor(high / step + 1e-9) + 1)]


def round_up(value: float) -> float:
    """Return the smallest number of the series 1, 2, 5, 10, 20, … (and 0.5, 0.2, …) that is at least `value` > 0."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(k * power for k in (1.0, 2.0, 5.0, 10.0) if k * power >= value * (1 - 1e-9))


def round_down(value: float) -> float:
    """Return the largest number of the series 1, 2, 5, 10, 20, … (and 0.5, 0.2, …) that is at most `value` > 0."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(k * power for k in (10.0, 5.0, 2.0, 1.0) if k * power <= value * (1 + 1e-9))


def number(value: float | None, digits: int = 3) -> str:
    """Format a number with the typographic minus sign; return "–" for None, NaN and infinities."""
    if value is None or not math.isfinite(value):
        return "–"
    # A value that rounds to zero must not show as "-0.000".
    rounded = f"{value:.{digits}f}"
    return ("−" + rounded[1:]) if rounded.startswith("-") and float(rounded) else rounded.lstrip("-")
