"""HTML and SVG as text: every value is escaped, numbers are as short as they may be."""

from __future__ import annotations

import math
from collections.abc import Iterable
from html import escape

Value = str | int | float


def tag(name: str, *content: str, **attributes: Value | None) -> str:
    """An element; `_` in names of attributes stands for `-`, a trailing one is left out; None leaves one out."""
    given = "".join(
        f' {key.rstrip("_").replace("_", "-")}="{escape(shown(value))}"'
        for key, value in attributes.items()
        if value is not None
    )
    if not content:
        return f"<{name}{given}/>" if name in _EMPTY else f"<{name}{given}></{name}>"
    return f"<{name}{given}>{''.join(content)}</{name}>"


def text(value: object) -> str:
    """Text as content."""
    return escape(str(value), quote=False)


def title(words: str) -> str:
    """What is shown where the pointer rests."""
    return tag("title", text(words))


def shown(value: Value) -> str:
    """A value of an attribute: numbers with at most two decimals, as drawings need no more."""
    if isinstance(value, float):
        return f"{value:.2f}".rstrip("0").rstrip(".") if math.isfinite(value) else "0"
    return str(value)


def drawing(width: float, height: float, *content: str, label: str, widest: float | None = None) -> str:
    """An SVG in user units of one CSS px, drawn smaller where there is no room for it."""
    return tag(
        "svg",
        tag("title", text(label)),
        *content,
        viewBox=f"0 0 {shown(float(width))} {shown(float(height))}",
        width=float(widest or width),
        role="img",
    )


def polyline(points: Iterable[tuple[float, float]], **attributes: Value | None) -> str:
    """Straight lines from point to point."""
    return tag("polyline", points=_points(points), fill="none", **attributes)


def polygon(points: Iterable[tuple[float, float]], *content: str, **attributes: Value | None) -> str:
    """A closed shape."""
    return tag("polygon", *content, points=_points(points), **attributes)


def label(x: float, y: float, words: str, **attributes: Value | None) -> str:
    """Text at a place."""
    return tag("text", text(words), x=float(x), y=float(y), **attributes)


def _points(points: Iterable[tuple[float, float]]) -> str:
    return " ".join(f"{shown(float(x))},{shown(float(y))}" for x, y in points)


_EMPTY = frozenset({"line", "circle", "rect", "polyline", "polygon", "use", "image", "path", "col", "meta", "br"})
