"""HTML and SVG: escaping, pages and tables, axes and curves, thumbnails."""

from __future__ import annotations

import base64
import math
from collections.abc import Iterable, Sequence
from dataclasses import dataclass
from html import escape
from importlib import resources
from typing import Any

import cv2
import numpy as np
from numpy.typing import NDArray

from vaoi_station.files.images import encode_jpeg
from vaoi_station.geometry.transforms import Floats
from vaoi_station.pixel_formats import eight_bit_grey

Value = str | int | float


def tag(name: str, *content: str, **attributes: Value | None) -> str:
    """Return an HTML or SVG element with its attributes.

    In the name of an attribute, `_` stands for `-`, and an `_` at the end is dropped. An attribute of value None is
    left out.
    """
    given = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escape(shown(value))}"'
        for key, value in attributes.items()
        if value is not None
    )
    # HTML forbids the short form for elements that may have content, such as <td/>.
    if not content:
        return f"<{name}{given}/>" if name in _EMPTY else f"<{name}{given}></{name}>"
    return f"<{name}{given}>{''.join(content)}</{name}>"


def text(value: object) -> str:
    """Escape a text, so that it can stand between tags."""
    return escape(str(value), quote=False)


def title(words: str) -> str:
    """Return the `<title>` element, which gives an SVG element its tooltip."""
    return tag("title", text(words))


def shown(value: Value) -> str:
    """Format the value of an attribute; numbers get two decimals, which are enough for drawings."""
    # Browsers reject NaN in an attribute and log an error; zero keeps the drawing valid.
    if isinstance(value, float):
        return f"{value:.2f}".rstrip("0").rstrip(".") if math.isfinite(value) else "0"
    return str(value)


def drawing(width: float, height: float, *content: str, label: str, widest: float | None = None) -> str:
    """Return an SVG element of the given width and height in CSS px. The page's style shrinks it on narrow screens."""
    return tag(
        "svg",
        tag("title", text(label)),
        *content,
        viewBox=f"0 0 {shown(float(width))} {shown(float(height))}",
        width=float(widest or width),
        role="img",
    )


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


_EMPTY = frozenset({"line", "circle", "rect", "polyline", "polygon", "use", "image", "path", "col", "meta", "br"})


# The browser enforces this policy: even if an error in the escaping let markup through, nothing is loaded or run.
POLICY = "default-src 'none'; img-src data:; style-src 'unsafe-inline'; base-uri 'none'; form-action 'none'"


@dataclass(frozen=True)
class Section:
    """One section of the report. Links within the page use `name` as the address of the section."""

    name: str
    heading: str
    lead: str
    """A sentence that explains how to read the section."""
    body: str

    def html(self) -> str:
        """Return the HTML of the section: heading, explanation, content."""
        lead = tag("p", text(self.lead), class_="lead") if self.lead else ""
        return tag("section", tag("h2", text(self.heading)), lead, self.body, id=self.name)


def page(title: str, head: str, sections: Sequence[Section], data: str) -> str:
    """Return the report as one HTML document. `data` is the script element that contains the numbers as JSON."""
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


def table(columns: Sequence[str], rows: Sequence[Sequence[str]], numbers: int | None = None) -> str:
    """Return an HTML table of texts. The columns from index `numbers` on contain numbers, aligned to the right."""
    first = len(columns) if numbers is None else numbers
    head = "".join(tag("th", text(c), class_="n" if k >= first else None) for k, c in enumerate(columns))
    body = "".join(
        tag("tr", *(tag("td", text(v), class_="n" if k >= first else None) for k, v in enumerate(row))) for row in rows
    )
    return tag("div", tag("table", tag("thead", tag("tr", head)), tag("tbody", body)), class_="scroll")


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


WIDEST_PX, NARROWEST_PX = 240, 40
_ALL_PX = 128 * 96 * 600
"""Limit for the pixels of all thumbnails together, so that the report of any run stays within a few MB."""
_QUALITY = 60
_BRIGHTEST = 99.5
"""The percentile that becomes white, so that dark frames are visible too."""


@dataclass(frozen=True)
class Thumbnail:
    """A reduced frame as the bytes of a JPEG, with its width and height in px."""

    jpeg: bytes
    width: int
    height: int

    @property
    def uri(self) -> str:
        """The picture as a data URI."""
        return "data:image/jpeg;base64," + base64.b64encode(self.jpeg).decode("ascii")


def thumbnail_width(frames: int) -> int:
    """Return the width in px of each thumbnail. The more frames a run has, the smaller they are."""
    fair = int((_ALL_PX / max(frames, 1) * 4 / 3) ** 0.5)
    return min(max(fair, NARROWEST_PX), WIDEST_PX)


def thumbnail(pixels: NDArray[Any], width: int) -> Thumbnail:
    """Reduce a frame (h, w) or (h, w, 3), 8 or 16 bit, to a width in px, and brighten it. Never enlarge a frame."""
    grey = eight_bit_grey(pixels)
    h, w = grey.shape
    width = min(width, w)
    size = (width, max(round(h * width / w), 1))
    # INTER_AREA averages all pixels under a thumbnail pixel; other methods skip most of them and alias.
    small = cv2.resize(grey, size, interpolation=cv2.INTER_AREA)
    # The lower limit of 40 keeps the noise of a black frame black.
    gain = 235 / max(float(np.percentile(small, _BRIGHTEST)), 40.0)
    return Thumbnail(encode_jpeg(cv2.convertScaleAbs(small, alpha=max(gain, 1.0)), _QUALITY), *size)
