"""Paint a generated board: one texture for its surface, and one small texture for the top of each body.

Grey values are those of a red solder mask under red light, at gain 1. The surface texture also contains a
narrow margin of belt around the board, so that the board's edge lies at its exact sub-pixel position.
"""

from __future__ import annotations

from dataclasses import dataclass
from itertools import chain

import cv2
import numpy as np

from vaoi_station.geometry.transforms import Floats
from vaoi_station.simulation.board.bodies import Body, build_bodies
from vaoi_station.simulation.board.canvas import Bytes, Canvas, bands, to_bytes
from vaoi_station.simulation.board.layout import Part, mounting_holes, place_parts
from vaoi_station.simulation.board.packages import Finish
from vaoi_station.simulation.board.panel import BadMark, bad_marks_at, marks_at, real_poses
from vaoi_station.simulation.board.routing import Copper, route
from vaoi_station.simulation.scenario import BoardSection, FiducialMark

RIM_PX = 2
"""Width of the belt margin around the board, in texture pixels."""
MASK, MASK_ON_COPPER, GAP = 62.0, 70.0, 50.0
TRACE, SILK, GOLD, TIN, COPPER, LAMINATE, HOLE = 88.0, 205.0, 172.0, 186.0, 222.0, 46.0, 12.0


@dataclass(frozen=True, eq=False)
class Artwork:
    """The parts, bodies and textures of a board type. All boards of the type share them."""

    parts: tuple[Part, ...]
    bodies: tuple[Body, ...]
    surface: Bytes
    """Grey values of the surface texture at gain 1, (h, w)."""
    metal: Bytes
    """Share of metal in each pixel of the surface texture, (h, w), 0 to 255."""
    px_per_mm: float
    origin_mm: tuple[float, float]

    def to_px(self, places_mm: Floats) -> Floats:
        """Convert board coordinates (..., 2) in mm to pixels (..., 2) of the surface texture."""
        return np.asarray((places_mm - self.origin_mm) * self.px_per_mm - 0.5)


def draw(section: BoardSection, px_per_mm: float, belt_grey: float) -> Artwork:
    """Generate the parts of a board and paint its textures, on a belt of an even grey."""
    parts = place_parts(section)
    rim = RIM_PX / px_per_mm
    size = (section.width_mm + 2 * rim, section.length_mm + 2 * rim)
    canvas = Canvas.blank((-rim, -rim), size, px_per_mm, MASK)
    _paint_surface(canvas, section, parts)
    for mark in section.marks:
        paint_fiducial(canvas, mark)
    if section.panel is not None:
        poses = real_poses(section.panel)
        for mark in chain.from_iterable(marks_at(section.panel, poses).values()):
            paint_fiducial(canvas, mark)
        for bad in bad_marks_at(section.panel, poses).values():
            _paint_bad_mark(canvas, bad)
    # The belt is painted last, so that it covers everything that extends beyond the board's edge.
    _paint_belt(canvas, section, belt_grey)
    bodies = build_bodies(parts, px_per_mm)
    surface, metal = to_bytes(canvas.grey), to_bytes(canvas.metal, 255)
    return Artwork(parts, bodies, surface, metal, px_per_mm, canvas.origin_mm)


def _paint_surface(canvas: Canvas, section: BoardSection, parts: tuple[Part, ...]) -> None:
    """Paint copper, solder mask, silkscreen, vias, holes and pads, in the order of their manufacture."""
    copper = route(section, parts)
    _paint_copper(canvas, section, parts, copper)
    _paint_mask_texture(canvas, section.seed)
    _paint_silk(canvas, section, parts)
    for place in copper.vias:
        canvas.disc(place, 0.62, GOLD, metal=1.0)
        canvas.disc(place, 0.3, HOLE)
    for place in mounting_holes(section):
        canvas.disc(place, 4.6, GOLD, metal=1.0)
        canvas.disc(place, 3.2, HOLE)
    for part in parts:
        _paint_pads(canvas, part)


def _paint_copper(canvas: Canvas, section: BoardSection, parts: tuple[Part, ...], copper: Copper) -> None:
    w, h = section.width_mm, section.length_mm
    canvas.box((w / 2, h / 2), (w - 1.0, h - 1.0), MASK_ON_COPPER)
    # The clearance of all traces is painted before the first trace. Otherwise it would cut neighbouring traces.
    canvas.strokes(list(copper.traces), 0.6, GAP)
    for part in parts:
        for u, v, pw, ph in part.package.pads:
            canvas.box(part.to_board_point(u, v), (pw + 0.4, ph + 0.4), GAP, turned_deg=part.turned_deg)
    for place in copper.vias:
        canvas.disc(place, 0.9, GAP)
    canvas.strokes(list(copper.traces), 0.24, TRACE)


def _paint_mask_texture(canvas: Canvas, seed: int) -> None:
    """Add the uneven brightness of solder mask: blotches of about 1 mm, and fine grain."""
    g, (h, w), k = np.random.default_rng([seed, 7030]), canvas.grey.shape, canvas.px_per_mm
    coarse = g.standard_normal((int(h / k) + 3, int(w / k) + 3), dtype=np.float32)
    fine = cv2.GaussianBlur(g.standard_normal((h, w), dtype=np.float32), (0, 0), max(0.035 * k, 0.6))
    blotches, scatter = cv2.resize(coarse, (w, h), interpolation=cv2.INTER_LINEAR), fine.std()
    # The image is processed in bands. A temporary array of its whole size would take a gigabyte on a large board.
    for band in bands(h):
        canvas.grey[band] += 1.6 * blotches[band] + 1.3 * fine[band] / scatter


def _paint_silk(canvas: Canvas, section: BoardSection, parts: tuple[Part, ...]) -> None:
    outlines = []
    for part in parts:
        w, h = part.package.body
        if part.package.round:
            a = np.linspace(0, 2 * np.pi, 49)
            local = np.column_stack([np.cos(a), np.sin(a)]) * (w / 2 + 0.2)
        else:
            x, y = w / 2 + 0.18, h / 2 + 0.18
            local = np.array([[-x, -y], [x, -y], [x, y], [-x, y], [-x, -y]])
        outlines.append(part.to_board(local))
        # Boards of LEDs have no room for names, and need none.
        if section.grid_mm is None:
            _paint_ref(canvas, part)
        if part.package.finish is Finish.EPOXY and part.package.size[0] > 4:
            u, v, *_ = part.package.pads[0]
            canvas.disc(part.to_board_point(u, v - 0.9), 0.35, SILK)
    canvas.strokes(outlines, 0.13, SILK)
    w, h = section.width_mm, section.length_mm
    if w >= 30:
        canvas.text(section.name.upper(), (w * 0.5, h - 2.2), min(1.6, h / 25), SILK)
        # This lettering must not change, because a different letter would change every simulated frame.
        canvas.text("REV B  MADE BY NOBODY", (w * 0.5 + 0.25 * w, h - 2.0), min(0.9, h / 40), SILK)


def _paint_ref(canvas: Canvas, part: Part) -> None:
    """Paint the name of a part beside it; in a group of chips, on a side that is free."""
    half_w, half_h = part.half_extent
    x, y = part.place
    tall = 1.0 if min(part.package.size) > 1.5 else 0.65
    away = 0.65 * tall + 0.1
    beside = part.turned_deg % 180 == 0 if part.package.small else half_w < half_h
    if not beside and part.package.small:
        canvas.text(part.ref, (x, y - half_h - 0.15 - 0.38 * tall * len(part.ref)), tall, SILK, 90.0)
    elif not beside:
        y += -(half_h + away) if y > half_h + 2 * tall else half_h + away
        canvas.text(part.ref, (x, y), tall, SILK)
    elif part.package.small:
        canvas.text(part.ref, (x - half_w - 0.15 - 0.38 * tall * len(part.ref), y), tall, SILK)
    else:
        x += -(half_w + away) if x > half_w + 2 * tall else half_w + away
        canvas.text(part.ref, (x, y), tall, SILK, 90.0)


def _paint_pads(canvas: Canvas, part: Part) -> None:
    # The seed is the part's name, so that adding or removing a part does not change the pads of other parts.
    g = np.random.default_rng([len(part.ref), *part.ref.encode()])
    for u, v, w, h in part.package.pads:
        x, y = part.to_board(np.array([u, v]))
        shine = float(g.normal(0, 7))
        canvas.box((x, y), (w, h), TIN - 18 + shine, metal=1.0, turned_deg=part.turned_deg)
        canvas.box((x, y), (w * 0.72, h * 0.72), TIN + 14 + shine, metal=1.0, turned_deg=part.turned_deg)
    for u, v, w, h in part.package.leads:
        canvas.box(part.to_board_point(u, v), (w, h), 214.0, metal=1.0, turned_deg=part.turned_deg)
        canvas.box(
            part.to_board_point(u * 1.02, v * 1.02), (w * 0.35, h * 0.8), 128.0, metal=1.0, turned_deg=part.turned_deg
        )


def paint_fiducial(canvas: Canvas, mark: FiducialMark) -> None:
    """Paint a fiducial at its exact position: bare copper on a disc of bare laminate, which is free of solder mask."""
    place, d = (mark.x_mm, mark.y_mm), mark.diameter_mm
    canvas.disc(place, 2.2 * d, LAMINATE)
    if mark.shape == "circle":
        canvas.disc(place, d, COPPER, metal=1.0)
    elif mark.shape == "cross":
        canvas.cross(place, d, d / 4, COPPER, metal=1.0)
    else:
        side = d if mark.shape == "square" else d / np.sqrt(2)
        canvas.box(place, (side, side), COPPER, metal=1.0, turned_deg=0.0 if mark.shape == "square" else 45.0)


def _paint_bad_mark(canvas: Canvas, mark: BadMark) -> None:
    """Paint a bad-board mark on a disc of even solder mask; one half of it may look otherwise than the other."""
    place, d = (mark.x_mm, mark.y_mm), mark.diameter_mm
    grey = {"dark": HOLE, "light": SILK, "blank": MASK_ON_COPPER}
    canvas.disc(place, 2.2 * d, MASK_ON_COPPER)
    canvas.disc(place, d, grey[mark.look])
    if mark.half != mark.look:
        canvas.box((mark.x_mm + d / 4, mark.y_mm), (d / 2, 0.85 * d), grey[mark.half])


def _paint_belt(canvas: Canvas, section: BoardSection, grey: float) -> None:
    mask = Canvas(np.zeros_like(canvas.grey), np.zeros_like(canvas.metal), canvas.origin_mm, canvas.px_per_mm)
    w, h = section.width_mm, section.length_mm
    mask.box((w / 2, h / 2), (w, h), 1.0)
    for band in bands(len(canvas.grey)):
        inside = mask.grey[band]
        canvas.grey[band] = canvas.grey[band] * inside + np.float32(grey) * (1 - inside)
        canvas.metal[band] *= inside
