"""Build HTML and SVG as text. All values are escaped, and numbers have few digits."""

from __future__ import annotations

import math
from collections.abc import Iterable
from html import escape

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
