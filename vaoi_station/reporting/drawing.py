"""HTML and SVG: escaping, pages and tables, axes, curves and colours."""

from __future__ import annotations

import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from importlib import resources

import numpy as np
from numpy.typing import NDArray

from vaoi_station.geometry.transforms import Floats

Value = str | int | float
_EMPTY = frozenset({"line", "circle", "rect", "polyline", "polygon", "use", "image", "path", "col", "meta", "br"})


def tag(name: str, *content: str, **attributes: Value | None) -> str:
    """Return an HTML or SVG element with its attributes; those that are None are left out.

    In the name of an attribute, `_` stands for `-`, and an `_` at the end is dropped.
    """
    given = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escape(shown(value))}"'
        for key, value in attributes.items()
        if value is not None
    )
    # HTML forbids the short form for elements that may have content, such as <td/>.
    if not content and name in _EMPTY:
        return f"<{name}{given}/>"
    return f"<{name}{given}>{''.join(content)}</{name}>"


def text(value: object) -> str:
    """Escape a text, so that it can stand between tags."""
    return escape(str(value), quote=False)


def title(words: str) -> str:
    """Return the element that gives an SVG element its tooltip."""
    return tag("title", text(words))


def shown(value: Value) -> str:
    """Format the value of an attribute; numbers get two decimals, which are enough for drawings."""
    # Browsers reject NaN in an attribute and log an error; zero keeps the drawing valid.
    if isinstance(value, float):
        return f"{value:.2f}".rstrip("0").rstrip(".") if math.isfinite(value) else "0"
    return str(value)


def drawing(width: float, height: float, *content: str, label: str) -> str:
    """Return an SVG element of the given width and height in CSS px. The page's style shrinks it on narrow screens."""
    box = f"0 0 {shown(float(width))} {shown(float(height))}"
    return tag("svg", title(label), *content, viewBox=box, width=float(width), role="img")


def polyline(points: Iterable[tuple[float, float]], **attributes: Value | None) -> str:
    """Return an SVG line that connects the points in order."""
    return tag("polyline", points=_points(points), fill="none", **attributes)


def polygon(points: Iterable[tuple[float, float]], *content: str, **attributes: Value | None) -> str:
    """Return an SVG polygon that connects the points in order and is closed."""
    return tag("polygon", *content, points=_points(points), **attributes)


def label(x: float, y: float, words: str, **attributes: Value | None) -> str:
    """Return an SVG text element at the position (x, y)."""
    return tag("text", text(words), x=float(x), y=float(y), **attributes)


def _points(points: Iterable[tuple[float, float]]) -> str:
    return " ".join(f"{shown(float(x))},{shown(float(y))}" for x, y in points)


# The browser enforces this policy: even if an error in the escaping let markup through, nothing is loaded or run.
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"


@dataclass(frozen=True)
class Section:
    """One section of a report; `name` is its address within the page, `lead` says how to read it, `body` is HTML."""

    name: str
    heading: str
    lead: str
    body: str

    def html(self) -> str:
        """Return the HTML of the section."""
        lead = tag("p", text(self.lead), class_="lead") if self.lead else ""
        return tag("section", tag("h2", text(self.heading)), lead, self.body, id=self.name)

    @classmethod
    def empty(cls, name: str, heading: str, why: str) -> Section:
        """Return a section that only says why it has no content."""
        return cls(name, heading, "", tag("p", text(why), class_="none"))


def page(title: str, head: str, sections: Sequence[Section], data: str) -> str:
    """Return a report as one HTML document. `data` is the script element that contains the numbers as JSON."""
    # The style is embedded: the report must look the same without network and without this package.
    style = resources.files("vaoi_station.reporting").joinpath("report.css").read_text(encoding="utf-8")
    contents = "".join(tag("a", text(s.heading), href=f"#{s.name}") for s in sections)
    return "\n".join(
        [
            '<!doctype html>\n<html lang="en">\n<head>\n<meta charset="utf-8">',
            f'<meta http-equiv="Content-Security-Policy" content="{POLICY}">',
            '<meta name="viewport" content="width=device-width, initial-scale=1">',
            f"<title>{text(title)}</title>",
            f"<style>\n{style}</style>\n</head>\n<body>",
            head,
            tag("nav", contents),
            "<main>",
            *(s.html() for s in sections),
            "</main>",
            data,
            "</body>\n</html>\n",
        ]
    )


def table(columns: Sequence[str], rows: Sequence[Sequence[str]], numbers: int) -> str:
    """Return an HTML table of texts. The columns from index `numbers` on contain numbers, aligned to the right."""

    def line(cell: str, texts: Sequence[str]) -> str:
        return tag("tr", *(tag(cell, text(v), class_="n" if k >= numbers else None) for k, v in enumerate(texts)))

    body = "".join(line("td", row) for row in rows)
    return tag("div", tag("table", tag("thead", line("th", columns)), tag("tbody", body)), class_="scroll")


def facts(entries: Sequence[tuple[str, str]]) -> str:
    """Return pairs of name and value as an HTML definition list."""
    return tag("dl", *(tag("dt", text(name)) + tag("dd", text(value)) for name, value in entries))


def figures(*drawings: tuple[str, str]) -> str:
    """Return drawings side by side, each with its caption. Drawings and captions are HTML already."""
    shown = (tag("figure", drawing, tag("figcaption", caption)) for drawing, caption in drawings if drawing)
    return tag("div", *shown, class_="figures")


def folded(summary: str, content: str) -> str:
    """Return HTML that shows `summary`; a click on it unfolds `content`."""
    return tag("details", tag("summary", text(summary)), content)


RISING = ((62, 32, 98), (52, 94, 141), (38, 140, 136), (108, 186, 92), (250, 222, 60))
"""Colours from small to large values. Lightness rises monotonically, so that the scale is readable in grey too."""
ABOUT_ZERO = ((33, 78, 140), (126, 168, 206), (240, 240, 238), (222, 158, 120), (158, 58, 30))
"""Colours from negative to positive values; the middle colour stands for zero."""
GOOD = ((176, 58, 46), (214, 140, 50), (120, 160, 80), (24, 110, 80))
"""Colours for values from bad to good."""


@dataclass(frozen=True)
class Scale:
    """Colour scale for numbers from `low` to `high`. A number outside this range has the colour of the nearer end."""

    low: float
    high: float
    colours: tuple[tuple[int, int, int], ...] = RISING

    def __call__(self, value: float) -> str:
        """Return the colour of a number as `#rrggbb`."""
        at = np.linspace(self.low, self.high, len(self.colours))
        red, green, blue = (round(float(np.interp(value, at, channel))) for channel in np.transpose(self.colours))
        return f"#{red:02x}{green:02x}{blue:02x}"


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
    """Return the largest number of the same series that is at most `value` > 0."""
    power = 10.0 ** math.floor(math.log10(value))
    return next(k * power for k in (10.0, 5.0, 2.0, 1.0) if k * power <= value * (1 + 1e-9))


def number(value: float | None, digits: int = 3) -> str:
    """Format a number with the typographic minus sign; return "–" for None, NaN and infinities."""
    if value is None or not math.isfinite(value):
        return "–"
    # A value that rounds to zero must not show as "-0.000".
    rounded = f"{value:.{digits}f}"
    return ("−" + rounded[1:]) if rounded.startswith("-") and float(rounded) else rounded.lstrip("-")


_LEFT, _TOP, _BOTTOM, _HEIGHT = 58.0, 8.0, 26.0, 190.0
# An axis never spans less than this: rounding noise of a constant must not look like a motion.
_LEAST_SPAN = 1e-3
_MOST_POINTS = 200
"""Largest number of rows for which points are drawn on the curve. More points would overlap."""


def plot(name: str, unit: str, width: float, value: Floats, sigma: Floats, held: NDArray[np.bool_]) -> str:
    """Draw values (m,) of m rows with standard deviations (m,).

    Rows without evidence, where `held` (m,) is False, are drawn as hollow points.
    """
    rows = len(value)
    # Only rows with evidence set the scale: the uncertainty of the others can exceed all motion, and is cut off.
    sure = held if held.any() else ~held
    # Zero is always part of the axis, so that small and large motions can be distinguished at a glance.
    low = float(min((value - sigma)[sure].min(), value.min(), 0))
    high = float(max((value + sigma)[sure].max(), value.max(), 0))
    room = max((high - low) * 0.06, _LEAST_SPAN)
    low, high = low - room, high + room

    def y(at: Floats) -> Floats:
        return np.asarray(_TOP + (high - np.clip(at, low, high)) / (high - low) * (_HEIGHT - _TOP - _BOTTOM))

    x = np.linspace(_LEFT + 10, width - 14, rows) if rows > 1 else np.array([(_LEFT + width) / 2])
    line = np.column_stack([x, y(value)])
    edges = np.concatenate([np.column_stack([x, y(value + sigma)]), np.column_stack([x, y(value - sigma)])[::-1]])
    parts = [polygon(edges, fill="#34608d", fill_opacity=0.22), polyline(line, stroke="#22456b", stroke_width=1.5)]
    for j, (px, py) in enumerate(line if rows <= _MOST_POINTS else ()):
        words = f"row {j}: {number(value[j])} ± {number(sigma[j])} {unit}"
        words += "" if held[j] else ", placed by the nominal motion alone"
        look: dict[str, Value] = {"fill": "#22456b" if held[j] else "#fff", "stroke": "#22456b", "stroke_width": 1.3}
        parts.append(tag("circle", title(words), cx=float(px), cy=float(py), r=3.2, **look))
    marks = ticks(low, high)
    step = marks[1] - marks[0] if len(marks) > 1 else 1.0
    axes = []
    for v in marks:
        at, colour = float(y(np.array(v))), "#8a939b" if abs(v) < step * 1e-6 else "#e2e6e9"
        axes.append(tag("line", x1=_LEFT, x2=width, y1=at, y2=at, stroke=colour, stroke_width=1))
        words = number(v, max(0, -math.floor(math.log10(step))))
        axes.append(label(_LEFT - 6, at + 4, words, text_anchor="end", class_="faint"))
    for j in range(0, rows, max(1, round(round_up(max(rows - 1, 1) / 12)))):
        axes.append(label(x[j], _HEIGHT - 8, str(j), text_anchor="middle", class_="faint"))
    return drawing(width, _HEIGHT, *axes, *parts, label=f"{name} over rows")
