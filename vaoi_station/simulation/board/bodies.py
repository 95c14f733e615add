"""Bodies of parts: prisms and cylinders that stand above the board. Each has a texture for its top."""

from __future__ import annotations

from dataclasses import dataclass

import numpy as np

from vaoi_station.geometry.transforms import Floats
from vaoi_station.simulation.board.canvas import Bytes, Canvas, to_bytes
from vaoi_station.simulation.board.layout import Part
from vaoi_station.simulation.board.packages import Finish

_MARGIN_PX = 3
_TOP = {
    Finish.EPOXY: 40.0,
    Finish.RESISTOR: 32.0,
    Finish.CERAMIC: 112.0,
    Finish.CAN: 176.0,
    Finish.COIL: 48.0,
    Finish.CRYSTAL: 178.0,
    Finish.SOCKET: 158.0,
    Finish.HEADER: 26.0,
}
_METALLIC = {Finish.CAN: 0.8, Finish.CRYSTAL: 1.0, Finish.SOCKET: 0.8}


@dataclass(frozen=True, eq=False)
class Body:
    """One body. Its outline (k, 2), centre and texture origin are in board coordinates (mm), at the CAD position."""

    ref: str
    outline_mm: Floats
    height_mm: float
    side_grey: float
    center_mm: tuple[float, float]
    top: Bytes
    metal: Bytes
    cover: Bytes
    """Share of each texture pixel that lies on the top of the body, 0 to 255."""
    origin_mm: tuple[float, float]
    px_per_mm: float

    def to_px(self, places_mm: Floats) -> Floats:
        """Convert board coordinates (..., 2) in mm to pixels (..., 2) of this body's texture."""
        return np.asarray((places_mm - self.origin_mm) * self.px_per_mm - 0.5)


def build_bodies(parts: tuple[Part, ...], px_per_mm: float) -> tuple[Body, ...]:
    """Build the bodies of all parts with a body height above 0."""
    return tuple(_build(part, px_per_mm) for part in parts if part.body_height_mm > 0)


def _build(part: Part, px_per_mm: float) -> Body:
    outline = part.to_board(_outline(part))
    margin = _MARGIN_PX / px_per_mm
    # The origin is rounded to whole texture pixels, so that all bodies have the same sub-pixel sampling.
    low = np.floor((outline.min(0) - margin) * px_per_mm) / px_per_mm
    size = outline.max(0) + margin - low
    origin, wide = (float(low[0]), float(low[1])), (float(size[0]), float(size[1]))
    grey = _TOP[part.package.finish]
    canvas = Canvas.blank(origin, wide, px_per_mm, grey)
    canvas.metal[:] = _METALLIC.get(part.package.finish, 0.0)
    _PAINTERS[part.package.finish](canvas, part)
    cover = Canvas.blank(origin, wide, px_per_mm, 0.0)
    if part.package.round:
        cover.disc(part.place, part.package.body[0], 255.0)
    else:
        cover.box(part.place, part.package.body, 255.0, turned_deg=part.turned_deg)
    return Body(
        ref=part.ref,
        outline_mm=outline,
        height_mm=part.body_height_mm,
        side_grey=grey * 0.75,
        center_mm=part.place,
        top=to_bytes(canvas.grey),
        metal=to_bytes(canvas.metal, 255),
        cover=to_bytes(cover.grey),
        origin_mm=origin,
        px_per_mm=px_per_mm,
    )


def _outline(part: Part) -> Floats:
    w, h = part.package.body
    if part.package.round:
        a = np.linspace(0, 2 * np.pi, 40, endpoint=False)
        return np.column_stack([np.cos(a), np.sin(a)]) * (w / 2)
    return np.array([[-w, -h], [w, -h], [w, h], [-w, h]]) / 2


def _epoxy(canvas: Canvas, part: Part) -> None:
    w, h = part.package.body
    # Such a small body has room for two letters only.
    if min(w, h) < 2:
        canvas.text(_code(part, 2), part.place, 0.7, 120.0, part.turned_deg)
        return
    canvas.box(part.place, (w - 0.5, h - 0.5), 46.0, turned_deg=part.turned_deg)
    inset = 0.6 if min(w, h) < 5 else 1.1
    canvas.disc(part.to_board_point(-w / 2 + inset, -h / 2 + inset), inset, 24.0)
    tall, turned = min(1.1, w / 6.5, h / 6.5), part.turned_deg + (90 if h > w else 0)
    for n, line in enumerate((_code(part, 6), _code(part, 5, 1), _code(part, 4, 2))):
        at = (n - 1) * 1.7 * tall
        place = part.to_board_point(at, 0.0) if h > w else part.to_board_point(0.0, at)
        canvas.text(line, place, tall, 118.0, turned)


def _resistor(canvas: Canvas, part: Part) -> None:
    _caps(canvas, part, 0.2)
    if part.package.body[0] >= 1.6:
        canvas.text(_digits(part), part.place, part.package.body[1] * 0.45, 190.0, part.turned_deg)


def _caps(canvas: Canvas, part: Part, share: float = 0.25) -> None:
    """Paint the two metal end caps of a chip, each `share` of its length."""
    w, h = part.package.body
    for side in (-1, 1):
        place = part.to_board_point(side * w * (1 - share) / 2, 0.0)
        canvas.box(place, (w * share, h), 194.0, metal=1.0, turned_deg=part.turned_deg)


def _can(canvas: Canvas, part: Part) -> None:
    d = part.package.body[0]
    canvas.disc(part.place, d, 150.0, metal=0.8)
    canvas.disc(part.place, d * 0.88, 182.0, metal=0.8)
    canvas.box(part.to_board_point(-d * 0.36, 0.0), (d * 0.2, d * 0.55), 38.0, turned_deg=part.turned_deg)
    canvas.text(_digits(part), part.to_board_point(0.08 * d, -0.1 * d), d / 7, 60.0, part.turned_deg)
    canvas.text("35V", part.to_board_point(0.08 * d, 0.14 * d), d / 8, 60.0, part.turned_deg)


def _coil(canvas: Canvas, part: Part) -> None:
    w = part.package.body[0]
    canvas.disc(part.place, w * 0.86, 64.0)
    canvas.disc(part.place, w * 0.7, 40.0)
    canvas.text(_digits(part), part.place, w / 5, 170.0, part.turned_deg)


def _crystal(canvas: Canvas, part: Part) -> None:
    w, h = part.package.body
    canvas.box(part.place, (w - 0.5, h - 0.5), 196.0, metal=1.0, turned_deg=part.turned_deg)
    canvas.text("25.000", part.place, h / 4, 92.0, part.turned_deg)


def _socket(canvas: Canvas, part: Part) -> None:
    w, h = part.package.body
    canvas.box(part.place, (w - 0.6, h - 0.6), 168.0, metal=0.8, turned_deg=part.turned_deg)
    for u in (-0.28, 0.28):
        canvas.box(part.to_board_point(u * w, 0.1 * h), (w * 0.16, h * 0.35), 60.0, turned_deg=part.turned_deg)


def _header(canvas: Canvas, part: Part) -> None:
    for u, v, *_ in part.package.pads:
        canvas.box(part.to_board_point(u, v), (1.3, 1.3), 14.0, turned_deg=part.turned_deg)
        canvas.box(part.to_board_point(u, v), (0.64, 0.64), 182.0, metal=1.0, turned_deg=part.turned_deg)


_PAINTERS = {
    Finish.EPOXY: _epoxy,
    Finish.RESISTOR: _resistor,
    Finish.CERAMIC: _caps,
    Finish.CAN: _can,
    Finish.COIL: _coil,
    Finish.CRYSTAL: _crystal,
    Finish.SOCKET: _socket,
    Finish.HEADER: _header,
}


def _code(part: Part, length: int, line: int = 0) -> str:
    """Return random lettering of a given length, the same for the same name and line."""
    g = np.random.default_rng([line, *part.ref.encode()])
    return "".join(g.choice(list("ABCDEFGHKLMNPRSTUVXZ0123456789"), length))


def _digits(part: Part) -> str:
    g = np.random.default_rng([9, *part.ref.encode()])
    return f"{g.integers(10, 99)}{g.integers(0, 5)}"
