"""The tile graph: each frame drawn at its place on the board, and lines for the links between frames."""

from __future__ import annotations

from collections import defaultdict
from dataclasses import dataclass

import numpy as np

from vaoi_station.geometry.transforms import Floats
from vaoi_station.reporting.drawing.html_page import Section, folded, table
from vaoi_station.reporting.drawing.scales import GOOD, Scale, number
from vaoi_station.reporting.drawing.svg import drawing, label, polygon, tag, text, title
from vaoi_station.reporting.sections.frame_table import picture_id
from vaoi_station.reporting.stitched_run import FramePair, StitchedRun
from vaoi_station.stitching.matching.evidence import FrameKey

_WIDEST, _TALLEST, _MARGIN = 1180.0, 1000.0, 24.0
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
    scale = min((_WIDEST - 2 * _MARGIN) / span[0], (_TALLEST - 2 * _MARGIN) / span[1])
    placed = {key: (c - low) * scale + _MARGIN for key, c in corners.items()}
    return Layout(placed, float(span[0] * scale + 2 * _MARGIN), float(span[1] * scale + 2 * _MARGIN))


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
