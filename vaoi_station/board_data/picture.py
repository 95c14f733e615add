"""A picture of a board type: outline, cut-outs, marks and bodies, as SVG."""

from __future__ import annotations

from collections.abc import Iterable
from html import escape

import numpy as np

from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType

MOST_LABELS = 500
"""With more components, designators would cover one another and make the picture large."""
_STYLE = (
    "svg{background:#fff}.board{fill:#e8f0e8;stroke:#264;fill-rule:evenodd}.body{fill:#9ab;stroke:#345}"
    ".guess{fill:#fb8;stroke:#a40}.mark{fill:#c00}.other{fill:none;stroke:#c0c}text{fill:#000;font-family:sans-serif}"
)


def board_picture(board: BoardType) -> str:
    """Return a board type as SVG, as a person sees that side: a bottom is mirrored. Lengths are in its unit."""
    low, high = board.extent()
    outlying = [np.array([m.x, m.y]) for m in board.other_marks or ()]
    low, high = np.min([low, *outlying], axis=0), np.max([high, *outlying], axis=0)
    margin = 0.03 * float((high - low).max())
    flip = np.array([-1.0 if board.side == "bottom" else 1.0, -1.0 if board.y_axis == "up" else 1.0])
    corners = np.array([low, high]) * flip
    (x, y), (width, height) = corners.min(0) - margin, np.abs(high - low) + 2 * margin
    digits = 5 if board.unit == "inch" else 3

    def path(polygons: Iterable[Floats]) -> str:
        pieces = ("L".join(f"{px:.{digits}f} {py:.{digits}f}" for px, py in polygon * flip) for polygon in polygons)
        return "".join(f"M{piece}Z" for piece in pieces)

    def dot(kind: str, name: str, at: tuple[float, float], diameter: float) -> str:
        cx, cy = np.array(at) * flip
        place = f'cx="{cx:.{digits}f}" cy="{cy:.{digits}f}" r="{diameter / 2:.{digits}f}"'
        return f'<circle class="{kind}" {place}><title>{escape(name)}</title></circle>'

    frame = _corners(board, low, high)
    content = [
        f'<path class="board" d="{path([frame, *(np.array(c) for c in board.cut_outs or ())])}"/>',
        f'<path class="body" d="{path(board.footprint(c) for c in board.components if c.size_from != "guess")}"/>',
        f'<path class="guess" d="{path(board.footprint(c) for c in board.components if c.size_from == "guess")}"/>',
        *(dot("mark", f.name, (f.x, f.y), f.diameter) for f in board.fiducials),
        *(dot("other", f"{m.name} ({m.kind})", (m.x, m.y), m.diameter) for m in board.other_marks or ()),
    ]
    if len(board.components) <= MOST_LABELS:
        for c in board.components:
            cx, cy = np.array(c.center) * flip
            size = 0.35 * min(c.width, c.height)
            content.append(
                f'<text x="{cx:.{digits}f}" y="{cy:.{digits}f}" font-size="{size:.{digits}f}" text-anchor="middle">'
                f"{escape(c.address)}</text>"
            )
    box = f"{x:.{digits}f} {y:.{digits}f} {width:.{digits}f} {height:.{digits}f}"
    stroke = f'stroke-width="{0.001 * float((high - low).max()):.{digits}f}"'
    title = f"<title>{escape(board.name)}, {board.side}</title>"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{box}" width="900" {stroke}>{title}<style>{_STYLE}</style>'
        f"{''.join(content)}</svg>"
    )


def _corners(board: BoardType, low: Floats, high: Floats) -> Floats:
    """Return the outline as a polygon (n, 2); without one, the rectangle of the extent."""
    outline = board.outline or ((float(low[0]), float(low[1])), (float(high[0]), float(high[1])))
    if len(outline) > 2:
        return np.array(outline, dtype=np.float64)
    (x0, y0), (x1, y1) = outline
    return np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
