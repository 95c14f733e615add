"""Residual vectors of links over the frame of each camera.

An error of calibration or lens appears as a pattern that is the same in all rows; noise does not.
"""

from __future__ import annotations

from dataclasses import dataclass
from functools import partial

import numpy as np

from vaoi_station.geometry import Camera
from vaoi_station.geometry.transforms import Floats
from vaoi_station.reporting.drawing.html_page import Section, figures
from vaoi_station.reporting.drawing.scales import number, round_down
from vaoi_station.reporting.drawing.svg import drawing, label, tag, text, title
from vaoi_station.reporting.stitched_run import StitchedRun

_WIDTH = 374.0
_CELLS = 14
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
        size = camera.width_px / _CELLS
        x, y = (self.at_px // size).astype(np.int_).T
        _, cell, count = np.unique(y * _CELLS * 4 + x, return_inverse=True, return_counts=True)
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
    factor = round_down(0.8 * widest / _CELLS / max(float(np.percentile(lengths, 90)), 1e-4))
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
