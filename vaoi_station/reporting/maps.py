"""The sections of the report that draw the board: maps, residuals of links, the graph of frames."""

from __future__ import annotations

from collections import defaultdict
from collections.abc import Mapping

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.polygon import encloses
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType
from vaoi_station.reporting.drawing import (
    ABOUT_ZERO,
    GOOD,
    Scale,
    Section,
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

    def outline(self) -> Floats:
        """Return the corners (k, 2) of the board, in CAD units."""
        shape = self.board_type.outline
        if shape is not None and len(shape) > 2:
            return np.array(shape, dtype=np.float64)
        (a, b), (c, d) = self._low, self._high
        return np.array([[a, b], [c, b], [c, d], [a, d]])

    def cells(self) -> tuple[Floats, float]:
        """Return the centres (k, 2) of grid cells on the board, and their side, in CAD units."""
        side = float(max(self._high - self._low) / _CELLS)
        x, y = (np.arange(low + side / 2, high, side) for low, high in zip(self._low, self._high, strict=True))
        grid, shape = np.stack(np.meshgrid(x, y), -1).reshape(-1, 2), self.outline()
        return grid[[encloses(shape, p) for p in grid]], side

    def draw(self, scale: Scale, unit: str, digits: int, what: str, *content: str) -> str:
        """Complete a drawing: return `content` with the board's outline, and a colour legend below it."""
        top, long, steps = self.height + 6, 180.0, 36
        bars = [
            tag("rect", x=_MARGIN + k * long / steps, y=top, width=long / steps + 0.5, height=10, fill=scale(value))
            for k, value in enumerate(np.linspace(scale.low, scale.high, steps))
        ]
        high = f"{number(scale.high, digits)} {unit}"
        words = label(_MARGIN, top + 24, number(scale.low, digits), class_="faint")
        words += label(_MARGIN + long, top + 24, high, text_anchor="end", class_="faint")
        edge = polygon(self.at(self.outline()), fill="none", stroke="#4c555e", stroke_width=1.2)
        return drawing(max(self.width, 260.0), self.height + _LEGEND, *content, edge, *bars, words, label=what)

    def footprints(self, values: Mapping[str, float], scale: Scale, unit: str) -> str:
        """Draw all footprints in the colours of their components' values, grey without a value."""
        drawn = []
        # Large components first, so that small ones stay visible on top of them.
        for part in sorted(self.board_type.components, key=lambda p: -p.width * p.height):
            value = values.get(part.address)
            tooltip = title(f"{part.address}: " + ("–" if value is None else f"{number(value)} {unit}"))
            fill = "#dfe3e6" if value is None else scale(value)
            at = self.at(self.board_type.footprint(part))
            drawn.append(polygon(at, tooltip, fill=fill, stroke="#fff", stroke_width=0.6))
        return "".join(drawn)


def surface(stitched: StitchedRun) -> Section:
    """Draw the height of the board's surface (lift, tilt and bow) as a map of colours."""
    board_type, found = stitched.opened.setup.board_type, stitched.result.surface
    if board_type is None or found is None:
        return Section.empty(
            "surface", "Surface", "Not estimated: this needs a board type and a calibrated working distance."
        )
    plan = BoardDrawing(board_type)
    centres, side = plan.cells()
    heights = found.height_mm(centres)
    reach = max(0.02, float(np.abs(heights).max()))
    scale, wide = Scale(-reach, reach, ABOUT_ZERO), side * plan.scale
    cells = [
        tag("rect", x=float(x), y=float(y), width=wide + 0.3, height=wide + 0.3, fill=scale(float(h)))
        for (x, y), h in zip(plan.at(centres) - wide / 2, heights, strict=True)
    ]
    names = ("lift", "tilt along CAD x", "tilt along CAD y", "bow x²", "bow xy", "bow y²")
    terms = zip(names, (found.lift_mm, *found.tilt_mm, *found.bow_mm), strict=True)
    listed = table(["coefficient", "mm"], [[name, number(v, 4)] for name, v in terms], 1)
    lead = (
        "Height above the calibrated plane, a polynomial over the board. Coefficients are heights from centre to edge."
    )
    caption = text(f"height, mm: {number(float(heights.min()))} … {number(float(heights.max()))}")
    drawn = plan.draw(scale, "mm", 2, "height of the board", *cells)
    return Section("surface", "Surface", lead, figures((drawn, caption), (listed, "")))


def components(stitched: StitchedRun) -> Section:
    """Draw the heights and the uncertainties of the components as two maps, and list them in a table."""
    board_type, q, views = stitched.opened.setup.board_type, stitched.result.quality, stitched.result.components
    if board_type is None or not board_type.components or views is None:
        return Section.empty("components", "Components", "No component could be placed.")
    heights, sigma, found = q["heights_mm"], q["component_sigma_px"], stitched.findings.heights
    drawings, plan, count = [], BoardDrawing(board_type), len(board_type.components)
    if heights:
        # At least 0.5 mm: on a board of flat parts the noise of their heights would fill the whole colour scale.
        scale = Scale(min(0.0, *heights.values()), max(0.5, *heights.values()))
        drawn = plan.draw(scale, "mm", 2, "heights of components", plan.footprints(heights, scale, "mm"))
        drawings.append((drawn, text(f"height above the board, mm: {len(heights)} of {count} components")))
    if sigma:
        scale = Scale(min(sigma.values()), max(*sigma.values(), min(sigma.values()) + 0.01))
        drawn = plan.draw(scale, "px", 3, "uncertainty of components", plan.footprints(sigma, scale, "px"))
        drawings.append((drawn, text("standard deviation of the position in the image, px, worst view")))
    rows = []
    for p in board_type.components:
        height = found.get(p.address)
        measured = ["–"] * 3 if height is None else [number(height.mm), number(height.sigma_mm), str(height.links)]
        stated = None if p.body_height is None else p.body_height * board_type.mm_per_unit
        seen = str(len(views.get(p.address, ())))
        rows.append([p.address, seen, number(sigma.get(p.address)), *measured, number(stated)])
    columns = ["component", "views", "σ px", "height mm", "σ mm", "links", "CAD body mm"]
    listed = folded(f"figures of every component: {count}", table(columns, rows, 1))
    lead = (
        "The height of a component is that of the highest group of links on its body that agree. Components that are "
        "too small or too smooth have no height (grey). The board is drawn in CAD coordinates."
    )
    return Section("components", "Components", lead, figures(*drawings) + listed)


_WIDTH = 374.0
_ARROW_CELLS = 14
"""Number of grid cells across a frame. Each cell shows the mean residual of its links."""
_KINDS = {"rows": ("#22456b", "to other rows"), "neighbours": ("#c0561a", "to the other camera")}
Vectors = tuple[Floats, Floats]
"""Positions (k, 2) in a camera's frame, and residual vectors (k, 2), both in px along the image axes."""


def vectors(stitched: StitchedRun, number_: int, kind: str) -> Vectors:
    """Return the residuals of links of one kind in the frames of camera `number_`. Links without weight are left out.

    A residual points from the link's point to the position that the link's other frame predicts. Links between rows
    have both points in frames of one camera.
    """
    f, camera = stitched.findings, stitched.opened.setup.cameras[number_]
    links, adjusted = f.problem.links, f.adjusted
    # Residuals are along the tester's axes, in px. The camera's linear part without its scale turns them to image axes.
    turn = camera.image_from_row.matrix[:2, :2] / camera.px_per_mm
    at, off = [np.zeros((0, 2))], [np.zeros((0, 2))]
    for n, e in enumerate(links.groups):
        if e.task.kind != kind or e.task.b is None:
            continue
        mine = links.group == n
        keep = adjusted.weight[mine] > 0.1
        px = adjusted.link_px[mine][keep] @ turn.T
        for key, points, vector in ((e.task.a, e.a_px, px), (e.task.b, e.b_px, -px)):
            if key[0] == number_:
                at.append(points[keep])
                off.append(vector)
    return np.concatenate(at), np.concatenate(off)


def means(found: Vectors, camera: Camera) -> Vectors:
    """Average vectors in each cell of a grid over the frame, at the mean position of the cell's links."""
    x, y = (found[0] // (camera.width_px / _ARROW_CELLS)).astype(np.int_).T
    _, cell, count = np.unique(y * _ARROW_CELLS * 4 + x, return_inverse=True, return_counts=True)
    at_x, at_y, off_x, off_y = (np.bincount(cell, v) / count for v in (*found[0].T, *found[1].T))
    return np.stack([at_x, at_y], -1), np.stack([off_x, off_y], -1)


def residual_vectors(stitched: StitchedRun) -> Section:
    """Draw the mean residuals in each camera's frame as arrows. All drawings enlarge them by the same factor."""
    cameras = stitched.opened.setup.cameras
    found = [{kind: vectors(stitched, i, kind) for kind in _KINDS} for i in range(stitched.cameras)]
    shown = [{k: means(v, cameras[i]) for k, v in of_camera.items() if len(v[0])} for i, of_camera in enumerate(found)]
    lengths = [np.hypot(*off.T) for of_camera in shown for _, off in of_camera.values()]
    if not lengths:
        return Section.empty("residuals", "Residuals", "There are no links.")
    # The 90th percentile, so that a few outliers do not shrink all other vectors.
    usual = max(float(np.percentile(np.concatenate(lengths), 90)), 1e-4)
    factor = round_down(0.8 * max(c.width_px for c in cameras) / _ARROW_CELLS / usual)
    drawings = []
    for i, camera in enumerate(cameras):
        parts = [
            f"{_KINDS[k][1]}: {len(off)} residuals, rms {number(float(np.sqrt((off**2).sum(1).mean())))} px"
            for k, (_, off) in found[i].items()
            if len(off)
        ]
        caption = text(f"camera {i}: " + ("; ".join(parts) or "no links"))
        drawings.append((_arrows(i, camera, shown[i], factor), caption))
    keys = (
        tag("span", class_="key", style=f"background:{colour}") + text(f"links {name}")
        for colour, name in _KINDS.values()
    )
    lead = (
        f"Residuals of links with weight, exaggerated {factor:,.0f}-fold, as means over cells of the frame: from a "
        "point in one frame to its prediction by the other frame. A pattern indicates a lens error, a camera that has "
        "moved, or a wrong surface."
    )
    return Section("residuals", "Residuals", lead, tag("p", *keys) + figures(*drawings))


def _arrows(number_: int, camera: Camera, shown: Mapping[str, Vectors], factor: float) -> str:
    """Draw vectors as lines, each with a dot at its start, in the frame of a camera."""
    scale = _WIDTH / camera.width_px
    height = camera.height_px * scale
    content = [tag("rect", width=_WIDTH, height=height, fill="#fafbfb", stroke="#c9ced3")]
    for kind, (at_px, off_px) in shown.items():
        start, end = at_px * scale, (at_px + off_px * factor) * scale
        lines = "".join(f"M{a:.1f} {b:.1f}L{c:.1f} {d:.1f}" for (a, b), (c, d) in zip(start, end, strict=True))
        dots = "".join(f"M{a:.1f} {b:.1f}h0" for a, b in start)
        for d, wide in ((lines, 1.8), (dots, 4.3)):
            look = {"stroke": _KINDS[kind][0], "fill": "none", "stroke_linecap": "round"}
            content.append(tag("path", d=d, stroke_width=wide, **look))
    unit = round_down(max(40 / scale / factor, 1e-9))
    end_x = 8 + unit * scale * factor
    content.append(tag("line", x1=8, x2=end_x, y1=height + 13, y2=height + 13, stroke="#1c2126", stroke_width=2))
    content.append(label(end_x + 6, height + 17, f"{unit:g} px, exaggerated ×{factor:,.0f}", class_="faint"))
    return drawing(_WIDTH, height + 22, *content, label=f"residuals of camera {number_}")


_GRAPH_WIDEST, _GRAPH_TALLEST, _GRAPH_MARGIN = 1180.0, 1000.0, 24.0
_SCORES = Scale(0.80, 1.0, GOOD)
_MOST_NAMED = 120
"""Largest number of tiles for which names are drawn. More names would cover the tiles."""


def layout(stitched: StitchedRun) -> tuple[dict[FrameKey, Floats], Floats]:
    """Place the tiles as the cameras see the board.

    Returns the corners (4, 2) of each frame that has a place on the board, in SVG user units, and the size (2,) of the
    drawing.
    """
    f, cameras = stitched.findings, stitched.opened.setup.cameras
    linear = cameras[0].image_from_row.matrix[:2, :2]
    # The nearest rotation by a multiple of 90°, with or without mirroring.
    straight = np.abs(np.diag(linear)).sum() >= np.abs(np.diag(linear[::-1])).sum()
    upright = np.sign(linear) * (np.eye(2) if straight else np.eye(2)[::-1])
    corners = {}
    for i, j in stitched.opened.present:
        if f.placed[j]:
            w, h = cameras[i].width_px, cameras[i].height_px
            frame = np.array([[0, 0], [w, 0], [w, h], [0, h]]) - 0.5
            corners[i, j] = f.adjusted.motion.board(np.full(4, j), cameras[i].ground(frame)) @ upright.T
    if not corners:
        return {}, np.zeros(2)
    everything = np.concatenate(list(corners.values()))
    low, span = everything.min(0), np.maximum(np.ptp(everything, axis=0), 1e-9)
    scale = ((np.array([_GRAPH_WIDEST, _GRAPH_TALLEST]) - 2 * _GRAPH_MARGIN) / span).min()
    placed = {key: (c - low) * scale + _GRAPH_MARGIN for key, c in corners.items()}
    return placed, span * scale + 2 * _GRAPH_MARGIN


def tile_graph(stitched: StitchedRun) -> Section:
    """Draw the tiles with pictures, a line with a score for each linked pair, and list the pairs without links."""
    corners, (width, height) = layout(stitched)
    if not corners:
        return Section.empty("tiles", "Tile graph", "No frame could be placed.")
    middles = {key: c.mean(0) for key, c in corners.items()}
    tiles = "".join(_tile(stitched, key, corners[key]) for key in sorted(corners, key=lambda k: (k[1], k[0])))
    # Strong edges are drawn last, on top of weak ones.
    pairs = sorted((p for p in stitched.pairs if p.a in middles and p.b in middles), key=lambda p: p.used)
    edges = "".join(_edge(p, middles[p.a], middles[p.b]) for p in pairs)
    nodes = "".join(_node(key, at, named=len(middles) <= _MOST_NAMED) for key, at in middles.items())
    drawn = drawing(float(width), float(height), tiles, edges, nodes, label="frames on the board, and their links")
    lead = (
        "Frames at their stitched positions, in board coordinates, as the cameras see the board. An edge is a pair of "
        "frames that was searched for links: its colour is their mean correlation, its width the number with weight. "
        "Curved edges skip a row. Tiles are named by camera and row. Dashed red edges: no link was found."
    )
    keys = [0.80, 0.85, 0.90, 0.95, 1.0]
    legend = tag("p", *(tag("span", class_="key", style=f"background:{_SCORES(v)}") + text(number(v, 2)) for v in keys))
    return Section("tiles", "Tile graph", lead, legend + drawn + _unlinked(stitched))


def _tile(stitched: StitchedRun, key: FrameKey, corners: Floats) -> str:
    t = stitched.thumbnails[key]
    across, down = (corners[1] - corners[0]) / t.width, (corners[3] - corners[0]) / t.height
    place = " ".join(f"{v:.5g}" for v in (*across, *down, *corners[0]))
    picture = tag("use", href=f"#{picture_id(key)}", transform=f"matrix({place})")
    return picture + polygon(corners, fill="none", stroke="#fff", stroke_opacity=0.55, stroke_width=0.7)


def _node(key: FrameKey, at: Floats, *, named: bool) -> str:
    x, y = (float(v) for v in at)
    tooltip = title(f"camera {key[0]}, row {key[1]}")
    node = tag("circle", tooltip, cx=x, cy=y, r=3.5, fill="#fff", stroke="#1c2126", stroke_width=1)
    ink = {"fill": "#fff", "stroke": "#1c2126", "paint_order": "stroke"}
    name = label(x + 7, y - 6, f"{key[0]}, {key[1]}", font_size=13, font_weight=600, stroke_width=3, **ink)
    return node + name if named else node


def _edge(pair: FramePair, a: Floats, b: Floats) -> str:
    (ax, ay), (bx, by) = a, b
    path = f"M{ax:.1f} {ay:.1f}L{bx:.1f} {by:.1f}"
    # A straight edge over two rows would cover the edges between them.
    if abs(pair.a[1] - pair.b[1]) > 1:
        bow_x, bow_y = (ax + bx) / 2 + (by - ay) * 0.22, (ay + by) / 2 - (bx - ax) * 0.22
        path = f"M{ax:.1f} {ay:.1f}Q{bow_x:.1f} {bow_y:.1f} {bx:.1f} {by:.1f}"
    words, count = f"camera {pair.a[0]} row {pair.a[1]} – camera {pair.b[0]} row {pair.b[1]}: ", len(pair.links.a_px)
    if not count:
        look = {"stroke": "#b00020", "stroke_dasharray": "5 4"}
        return tag("path", title(words + pair.links.note), d=path, fill="none", stroke_width=1.6, **look)
    score = float(pair.links.score.mean())
    words += f"{pair.used} of {count} links, correlation {number(score, 2)}, rms {number(pair.residual_px)} px"
    width = 1.0 + 3.5 * min(pair.used / 80, 1.0)
    halo = tag("path", d=path, fill="none", stroke="#fff", stroke_width=width + 1.6, stroke_opacity=0.8)
    return halo + tag("path", title(words), d=path, fill="none", stroke=_SCORES(score), stroke_width=width)


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
    return folded(f"pairs without links, with reasons: {total}", table(["reason", "pairs", "(camera, row)"], rows, 3))
