"""The sections of the report that draw the board: maps, residuals of links, the graph of frames."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping
from dataclasses import dataclass
from functools import partial

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.polygon import encloses
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Component
from vaoi_station.reporting.drawing import (
    GOOD,
    Scale,
    Section,
    about_zero,
    drawing,
    figures,
    folded,
    label,
    number,
    polygon,
    round_down,
    table,
    tag,
    text,
    title,
)
from vaoi_station.reporting.figures import picture_id
from vaoi_station.reporting.stitched_run import FramePair, StitchedRun
from vaoi_station.stitching.matching.evidence import FrameKey

_WIDEST, _TALLEST, _MARGIN, _LEGEND = 540.0, 460.0, 6.0, 40.0
_CELLS = 32
_LEAST_MM = 0.02


class BoardDrawing:
    """A drawing of the board in SVG user units, with the axes of CAD: x to the right, and up as in CAD."""

    def __init__(self, board_type: BoardType) -> None:
        self.board_type = board_type
        self._low, self._high = board_type.extent()
        span = np.maximum(self._high - self._low, 1e-9)
        self.scale = float(min((_WIDEST - 2 * _MARGIN) / span[0], (_TALLEST - 2 * _MARGIN) / span[1]))
        self.width, self.height = (float(v) for v in span * self.scale + 2 * _MARGIN)

    def at(self, cad: Floats) -> Floats:
        """Convert CAD points (k, 2) to SVG user units (k, 2) of the drawing."""
        x, y = ((np.asarray(cad, dtype=np.float64) - self._low) * self.scale + _MARGIN).T
        # SVG's y axis points down, so a CAD system whose y points up is mirrored here.
        return np.stack([x, self.height - y if self.board_type.y_axis == "up" else y], -1)

    def outline(self) -> str:
        """Draw the outline of the board."""
        return polygon(self.at(self._corners()), fill="none", stroke="#4c555e", stroke_width=1.2)

    def cells(self) -> tuple[Floats, float]:
        """Return the centres (k, 2) of grid cells on the board, and their side, in CAD units."""
        span = self._high - self._low
        side = float(max(span) / _CELLS)
        x, y = (np.arange(low + side / 2, high, side) for low, high in zip(self._low, self._high, strict=True))
        grid = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2)
        shape = self.board_type.outline
        return (grid if shape is None else grid[[encloses(shape, p) for p in grid]]), side

    def draw(self, scale: Scale, unit: str, digits: int, what: str, *content: str) -> str:
        """Complete a drawing: return `content` with the board's outline, and a colour legend below it."""
        wide = max(self.width, 260.0)
        shown = tag("g", *content, self.outline())
        return drawing(wide, self.height + _LEGEND, shown, self._legend(scale, unit, digits), label=what)

    def _legend(self, scale: Scale, unit: str, digits: int) -> str:
        top, long, steps = self.height + 6, 180.0, 36
        bars = "".join(
            tag("rect", x=_MARGIN + k * long / steps, y=top, width=long / steps + 0.5, height=10, fill=scale(
                scale.low + (k + 0.5) / steps * (scale.high - scale.low))) for k in range(steps)
        )  # fmt: skip
        low = label(_MARGIN, top + 24, number(scale.low, digits), class_="faint")
        high = label(
            _MARGIN + long, top + 24, f"{number(scale.high, digits)} {unit}", text_anchor="end", class_="faint"
        )
        return bars + low + high

    def _corners(self) -> Floats:
        shape = self.board_type.outline
        if shape is not None and len(shape) > 2:
            return np.array(shape)
        (a, b), (c, d) = self._low, self._high
        return np.array([[a, b], [c, b], [c, d], [a, d]])


def surface(stitched: StitchedRun) -> Section:
    """Draw the height of the board's surface (lift, tilt and bow) as a map of colours."""
    board_type, found = stitched.opened.setup.board_type, stitched.result.surface
    if board_type is None or found is None:
        note = tag("p", "Not estimated: this needs a board type and a calibrated working distance.", class_="none")
        return Section("surface", "Surface", "", note)
    plan = BoardDrawing(board_type)
    centres, side = plan.cells()
    heights = found.height_mm(centres)
    scale = about_zero(heights.tolist(), _LEAST_MM)
    half = side * plan.scale / 2
    cells = "".join(
        tag(
            "rect",
            x=float(x) - half,
            y=float(y) - half,
            width=2 * half + 0.3,
            height=2 * half + 0.3,
            fill=scale(float(h)),
        )
        for (x, y), h in zip(plan.at(centres), heights, strict=True)
    )
    terms = [
        ("lift", found.lift_mm), ("tilt along CAD x", found.tilt_mm[0]), ("tilt along CAD y", found.tilt_mm[1]),
        ("bow x²", found.bow_mm[0]), ("bow xy", found.bow_mm[1]), ("bow y²", found.bow_mm[2]),
    ]  # fmt: skip
    listed = table(["coefficient", "mm"], [[name, number(v, 4)] for name, v in terms], 1)
    lead = (
        "Height above the calibrated plane, a polynomial over the board. Coefficients are heights from centre to edge."
    )
    caption = text(f"height, mm: {number(float(heights.min()))} … {number(float(heights.max()))}")
    drawn = plan.draw(scale, "mm", 2, "height of the board", cells)
    return Section("surface", "Surface", lead, figures((drawn, caption), (listed, "")))


def components(stitched: StitchedRun) -> Section:
    """Draw the heights and the uncertainties of the components as two maps, and list them in a table."""
    board_type, q = stitched.opened.setup.board_type, stitched.result.quality
    if board_type is None or not board_type.components or stitched.result.components is None:
        note = tag("p", "No component could be placed.", class_="none")
        return Section("components", "Components", "", note)
    heights, sigma = q["heights_mm"], q["component_sigma_px"]
    drawings = []
    plan = BoardDrawing(board_type)
    if heights:
        # At least 0.5 mm: on a board of flat parts the noise of their heights would fill the whole colour scale.
        scale = Scale(min(0.0, *heights.values()), max(0.5, *heights.values()))
        drawn = plan.draw(scale, "mm", 2, "heights of components", _footprints(plan, heights, scale, "mm"))
        drawings.append(
            (drawn, text(f"height above the board, mm: {len(heights)} of {len(board_type.components)} components"))
        )
    if sigma:
        scale = Scale(min(sigma.values()), max(*sigma.values(), min(sigma.values()) + 0.01))
        drawn = plan.draw(scale, "px", 3, "uncertainty of components", _footprints(plan, sigma, scale, "px"))
        drawings.append((drawn, text("standard deviation of the position in the image, px, worst view")))
    columns = ["component", "views", "σ px", "height mm", "σ mm", "links", "CAD body mm"]
    listed = folded(
        f"figures of every component: {len(board_type.components)}", table(columns, _rows(stitched, board_type), 1)
    )
    lead = (
        "The height of a component is that of the highest group of links on its body that agree. Components that are "
        "too small or too smooth have no height (grey). The board is drawn in CAD coordinates."
    )
    return Section("components", "Components", lead, figures(*drawings) + listed)


def _footprints(plan: BoardDrawing, values: Mapping[str, float], scale: Scale, unit: str) -> str:
    """Draw all footprints. Each has the colour of its component's value in `values`, or is grey without a value."""
    # Large components first, so that small ones stay visible on top of them.
    parts = sorted(plan.board_type.components, key=lambda p: -p.width * p.height)
    return "".join(_footprint(plan, part, values.get(part.address), scale, unit) for part in parts)


def _footprint(plan: BoardDrawing, part: Component, value: float | None, scale: Scale, unit: str) -> str:
    tooltip = title(f"{part.address}: " + ("–" if value is None else f"{number(value)} {unit}"))
    fill = "#dfe3e6" if value is None else scale(value)
    return polygon(plan.at(plan.board_type.footprint(part)), tooltip, fill=fill, stroke="#fff", stroke_width=0.6)


def _rows(stitched: StitchedRun, board_type: BoardType) -> list[list[str]]:
    heights, sigma = stitched.findings.heights, stitched.result.quality["component_sigma_px"]
    views, mm = stitched.result.components or {}, board_type.mm_per_unit
    return [
        [
            p.address,
            str(len(views.get(p.address, ()))),
            number(sigma.get(p.address)),
            number(heights[p.address].mm if p.address in heights else None),
            number(heights[p.address].sigma_mm if p.address in heights else None),
            str(heights[p.address].links) if p.address in heights else "–",
            number(None if p.body_height is None else p.body_height * mm),
        ]
        for p in board_type.components
    ]


_WIDTH = 374.0
_ARROW_CELLS = 14
"""Number of grid cells across a frame. Each cell shows the mean residual of its links."""
_SINGLE = 250
"""Largest number of single links whose residuals are drawn in addition to the mean of each cell."""
_COLOURS = {"rows": "#22456b", "neighbours": "#c0561a"}
_NAMES = {"rows": "to other rows", "neighbours": "to the other camera"}


@dataclass(frozen=True, eq=False)
class Vectors:
    """The residuals of links in the frames of one camera.

    `at_px` (k, 2) are the positions in the frame, `off_px` (k, 2) the residual vectors, both in px along the image
    axes.
    """

    at_px: Floats
    off_px: Floats
    links: int = 0
    """Number of links.

    It is smaller than k for links between rows, because both points of such a link count in k."""

    @property
    def rms_px(self) -> float | None:
        """Root mean square length of the vectors; None without vectors."""
        return float(np.sqrt((self.off_px**2).sum(1).mean())) if len(self.off_px) else None

    def means(self, camera: Camera) -> Vectors:
        """Average the vectors in each cell of a grid over the frame, at the mean position of the cell's links."""
        if not len(self.at_px):
            return self
        size = camera.width_px / _ARROW_CELLS
        x, y = (self.at_px // size).astype(np.int_).T
        _, cell, count = np.unique(y * _ARROW_CELLS * 4 + x, return_inverse=True, return_counts=True)
        total = [np.bincount(cell, v) for v in (*self.at_px.T, *self.off_px.T)]
        at_x, at_y, off_x, off_y = (t / count for t in total)
        return Vectors(np.stack([at_x, at_y], -1), np.stack([off_x, off_y], -1))


def vectors(stitched: StitchedRun, number_: int, kind: str) -> Vectors:
    """Return the residuals of links of one kind in the frames of camera `number_`. Links without weight are left out.

    A residual points from the link's point to the position that the link's other frame predicts.
    """
    f, camera = stitched.findings, stitched.opened.setup.cameras[number_]
    links, adjusted = f.problem.links, f.adjusted
    # Residuals are along the tester's axes, in px. The camera's linear part without its scale turns them to image axes.
    turn = camera.image_from_row.matrix[:2, :2] / camera.px_per_mm
    at, off, count = [np.zeros((0, 2))], [np.zeros((0, 2))], 0
    for n, e in enumerate(links.groups):
        if e.task.kind != kind or e.task.b is None:
            continue
        mine = links.group == n
        keep = adjusted.weight[mine] > 0.1
        px = adjusted.link_px[mine][keep] @ turn.T
        count += len(px) if number_ in (e.task.a[0], e.task.b[0]) else 0
        if e.task.a[0] == number_:
            at.append(e.a_px[keep])
            off.append(px)
        if e.task.b[0] == number_:
            at.append(e.b_px[keep])
            off.append(-px)
    return Vectors(np.concatenate(at), np.concatenate(off), count)


def residual_vectors(stitched: StitchedRun) -> Section:
    """Draw the residuals of each camera as arrows. All drawings enlarge the residuals by the same factor."""
    kinds = list(_COLOURS)
    found = [{kind: vectors(stitched, i, kind) for kind in kinds} for i in range(stitched.cameras)]
    cameras = stitched.opened.setup.cameras
    shown = [m for i, v in enumerate(found) for m in (v[kind].means(cameras[i]) for kind in kinds) if len(m.off_px)]
    if not shown:
        return Section("residuals", "Residuals", "", tag("p", "There are no links.", class_="none"))
    lengths = np.concatenate([np.hypot(*m.off_px.T) for m in shown])
    widest = max(c.width_px for c in cameras)
    # The 90th percentile, so that a few outliers do not shrink all other vectors.
    factor = round_down(0.8 * widest / _ARROW_CELLS / max(float(np.percentile(lengths, 90)), 1e-4))
    drawings = [(_camera(stitched, i, v, factor), _caption(i, v)) for i, v in enumerate(found)]
    keys = "".join(
        tag("span", class_="key", style=f"background:{_COLOURS[k]}") + text(f"links {_NAMES[k]}") for k in kinds
    )
    lead = (
        f"Residuals of links with weight, exaggerated {factor:,.0f}-fold: from a point in one frame to its prediction "
        f"by the other frame. Thick: means over cells of the frame. Thin: single links ({_SINGLE} at most). A pattern "
        "in the means indicates a lens error, a camera that has moved, or a wrong surface."
    )
    return Section("residuals", "Residuals", lead, tag("p", keys) + figures(*drawings))


def _caption(number_: int, found: dict[str, Vectors]) -> str:
    parts = [f"{v.links} {_NAMES[k]}: rms {number(v.rms_px)} px" for k, v in found.items() if v.links]
    return text(f"camera {number_}: " + ("; ".join(parts) or "no links"))


def _camera(stitched: StitchedRun, number_: int, found: dict[str, Vectors], factor: float) -> str:
    camera = stitched.opened.setup.cameras[number_]
    scale = _WIDTH / camera.width_px
    height = camera.height_px * scale
    frame = tag("rect", width=_WIDTH, height=height, fill="#fafbfb", stroke="#c9ced3")
    content = [frame]
    for kind, v in found.items():
        # Every k-th link instead of the first ones, so that the whole frame is covered.
        step = max(1, -(-len(v.at_px) // _SINGLE))
        content.append(_arrows(v.at_px[::step], v.off_px[::step], scale, factor, _COLOURS[kind], 0.6, 0.35))
    for kind, v in found.items():
        m = v.means(camera)
        content.append(_arrows(m.at_px, m.off_px, scale, factor, _COLOURS[kind], 1.8, 1.0))
    unit = round_down(max(40 / scale / factor, 1e-9))
    long = unit * scale * factor
    bar = tag(
        "line",
        title(f"{unit:g} px"),
        x1=8,
        x2=8 + long,
        y1=height + 13,
        y2=height + 13,
        stroke="#1c2126",
        stroke_width=2,
    )
    words = label(8 + long + 6, height + 17, f"{unit:g} px, exaggerated ×{factor:,.0f}", class_="faint")
    return drawing(_WIDTH, height + 22, *content, bar, words, label=f"residuals of camera {number_}")


def _arrows(
    at_px: Floats, off_px: Floats, scale: float, factor: float, colour: str, thickness: float, opacity: float
) -> str:
    """Draw vectors as lines in one SVG path. A dot marks the point where a vector starts."""
    if not len(at_px):
        return ""
    start, end = at_px * scale, (at_px + off_px * factor) * scale
    lines = "".join(f"M{a:.1f} {b:.1f}L{c:.1f} {d:.1f}" for (a, b), (c, d) in zip(start, end, strict=True))
    dots = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in start)
    path = partial(tag, "path", stroke=colour, opacity=opacity, fill="none", stroke_linecap="round")
    return path(d=lines, stroke_width=thickness) + path(d=dots, stroke_width=2.4 * thickness)


_GRAPH_WIDEST, _GRAPH_TALLEST, _GRAPH_MARGIN = 1180.0, 1000.0, 24.0
_SCORES = Scale(0.80, 1.0, GOOD)
_UNLINKED = "#b00020"
_MOST_NAMED = 120
"""Largest number of tiles for which names are drawn. More names would cover the tiles."""


@dataclass(frozen=True, eq=False)
class Layout:
    """Positions of the tiles: `corners` holds for each frame (camera, row) its corners (4, 2) in SVG user units."""

    corners: dict[FrameKey, Floats]
    width: float
    height: float

    def middle(self, key: FrameKey) -> Floats:
        """Return the centre (2,) of a frame's tile, in SVG user units."""
        return np.asarray(self.corners[key].mean(0))


def layout(stitched: StitchedRun) -> Layout:
    """Place the tiles as the cameras see the board, and scale them to the size of the drawing."""
    f, cameras = stitched.findings, stitched.opened.setup.cameras
    upright = _quarter_turn(cameras[0].image_from_row.matrix[:2, :2])
    corners = {}
    for i, j in stitched.opened.present:
        # A row without a known motion has no position on the board.
        if not f.placed[j]:
            continue
        c = cameras[i]
        frame = np.array([[0, 0], [c.width_px, 0], [c.width_px, c.height_px], [0, c.height_px]]) - 0.5
        board = f.adjusted.motion.board(np.full(4, j), c.ground(frame))
        corners[i, j] = board @ upright.T
    if not corners:
        return Layout({}, 0.0, 0.0)
    everything = np.concatenate(list(corners.values()))
    low, span = everything.min(0), np.maximum(np.ptp(everything, axis=0), 1e-9)
    scale = min((_GRAPH_WIDEST - 2 * _GRAPH_MARGIN) / span[0], (_GRAPH_TALLEST - 2 * _GRAPH_MARGIN) / span[1])
    placed = {key: (c - low) * scale + _GRAPH_MARGIN for key, c in corners.items()}
    return Layout(placed, float(span[0] * scale + 2 * _GRAPH_MARGIN), float(span[1] * scale + 2 * _GRAPH_MARGIN))


def tile_graph(stitched: StitchedRun) -> Section:
    """Draw the tiles with pictures, a line with a score for each linked pair, and list the pairs without links."""
    plan = layout(stitched)
    if not plan.corners:
        return Section("tiles", "Tile graph", "", tag("p", "No frame could be placed.", class_="none"))
    tiles = "".join(_tile(stitched, plan, key) for key in sorted(plan.corners, key=lambda k: (k[1], k[0])))
    # Strong edges are drawn last, on top of weak ones.
    edges = "".join(_edge(plan, p) for p in sorted(stitched.pairs, key=lambda p: p.used))
    nodes = "".join(_node(plan, key) for key in plan.corners)
    drawn = drawing(plan.width, plan.height, tiles, edges, nodes, label="frames on the board, and their links")
    lead = (
        "Frames at their stitched positions, in board coordinates, as the cameras see the board. An edge is a pair of "
        "frames that was searched for links: its colour is their mean correlation, its width the number with weight. "
        "Curved edges skip a row. Tiles are named by camera and row. Dashed red edges: no link was found."
    )
    keys = [0.80, 0.85, 0.90, 0.95, 1.0]
    legend = tag("p", *(tag("span", class_="key", style=f"background:{_SCORES(v)}") + text(number(v, 2)) for v in keys))
    return Section("tiles", "Tile graph", lead, legend + drawn + _unlinked(stitched))


def _tile(stitched: StitchedRun, plan: Layout, key: FrameKey) -> str:
    t, c = stitched.thumbnails[key], plan.corners[key]
    across, down = (c[1] - c[0]) / t.width, (c[3] - c[0]) / t.height
    place = " ".join(f"{v:.5g}" for v in (*across, *down, *c[0]))
    picture = tag("use", href=f"#{picture_id(key)}", transform=f"matrix({place})")
    return picture + polygon(c, fill="none", stroke="#fff", stroke_opacity=0.55, stroke_width=0.7)


def _node(plan: Layout, key: FrameKey) -> str:
    x, y = (float(v) for v in plan.middle(key))
    tooltip = title(f"camera {key[0]}, row {key[1]}")
    node = tag("circle", tooltip, cx=x, cy=y, r=3.5, fill="#fff", stroke="#1c2126", stroke_width=1)
    if len(plan.corners) > _MOST_NAMED:
        return node
    name = f"{key[0]}, {key[1]}"
    ink = {"fill": "#fff", "stroke": "#1c2126", "paint_order": "stroke"}
    return node + label(x + 7, y - 6, name, font_size=13, font_weight=600, stroke_width=3, **ink)


def _edge(plan: Layout, pair: FramePair) -> str:
    if pair.a not in plan.corners or pair.b not in plan.corners:
        return ""
    (ax, ay), (bx, by) = plan.middle(pair.a), plan.middle(pair.b)
    tooltip = f"camera {pair.a[0]} row {pair.a[1]} – camera {pair.b[0]} row {pair.b[1]}: "
    path = f"M{ax:.1f} {ay:.1f}L{bx:.1f} {by:.1f}"
    # A straight edge over two rows would cover the edges between them.
    if abs(pair.a[1] - pair.b[1]) > 1:
        bow_x, bow_y = (ax + bx) / 2 + (by - ay) * 0.22, (ay + by) / 2 - (bx - ax) * 0.22
        path = f"M{ax:.1f} {ay:.1f}Q{bow_x:.1f} {bow_y:.1f} {bx:.1f} {by:.1f}"
    if not len(pair.links.a_px):
        tooltip += pair.links.note
        return tag(
            "path", title(tooltip), d=path, fill="none", stroke=_UNLINKED, stroke_dasharray="5 4", stroke_width=1.6
        )
    tooltip += f"{pair.used} of {len(pair.links.a_px)} links, correlation {number(pair.score, 2)}"
    if pair.residual_px is not None:
        tooltip += f", rms {number(pair.residual_px)} px"
    width = 1.0 + 3.5 * min(pair.used / 80, 1.0)
    halo = tag("path", d=path, fill="none", stroke="#fff", stroke_width=width + 1.6, stroke_opacity=0.8)
    return halo + tag("path", title(tooltip), d=path, fill="none", stroke=_SCORES(pair.score), stroke_width=width)


def _unlinked(stitched: StitchedRun) -> str:
    """List the pairs of frames without links, grouped by why there are none."""
    by_reason: dict[str, list[str]] = defaultdict(list)
    for pair in stitched.pairs:
        if not len(pair.links.a_px):
            by_reason[pair.links.note].append(f"({pair.a[0]}, {pair.a[1]})–({pair.b[0]}, {pair.b[1]})")
    if not by_reason:
        return ""
    rows = [[reason, str(len(pairs)), ", ".join(pairs)] for reason, pairs in by_reason.items()]
    total = sum(map(len, by_reason.values()))
    return folded(f"pairs without links, with reasons: {total}", table(["reason", "pairs", "(camera, row)"], rows))


def _quarter_turn(linear: Floats) -> Floats:
    """Return the rotation by a multiple of 90°, with or without mirroring, that is nearest to a linear map (2, 2)."""
    if abs(linear[0, 0]) + abs(linear[1, 1]) >= abs(linear[0, 1]) + abs(linear[1, 0]):
        return np.diag(np.sign(np.diag(linear)))
    return np.array([[0.0, np.sign(linear[0, 1])], [np.sign(linear[1, 0]), 0.0]])
