"""Maps of the board in CAD coordinates: surface, component heights, and uncertainty of positions."""

from __future__ import annotations

from collections.abc import Mapping

import numpy as np

from vaoi_station.geometry.polygon import encloses
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType, Component
from vaoi_station.reporting.drawing.html_page import Section, figures, folded, table
from vaoi_station.reporting.drawing.scales import Scale, about_zero, number
from vaoi_station.reporting.drawing.svg import drawing, label, polygon, tag, text, title
from vaoi_station.reporting.stitched_run import StitchedRun

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
