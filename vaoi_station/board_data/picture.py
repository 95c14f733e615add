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
    marks = [np.array([m.x, m.y]) for m in board.other_marks or ()]
    low, high = np.min([low, *marks], axis=0), np.max([high, *marks], axis=0)
    size = float((high - low).max())
    flip = np.array([-1.0 if board.side == "bottom" else 1.0, -1.0 if board.y_axis == "up" else 1.0])
    (x, y), (width, height) = (np.array([low, high]) * flip).min(0) - 0.03 * size, np.abs(high - low) + 0.06 * size
    digits = 5 if board.unit == "inch" else 3

    def path(kind: str, polygons: Iterable[Floats]) -> str:
        pieces = ("L".join(f"{px:.{digits}f} {py:.{digits}f}" for px, py in polygon * flip) for polygon in polygons)
        return f'<path class="{kind}" d="{"".join(f"M{piece}Z" for piece in pieces)}"/>'

    def dot(kind: str, name: str, at: tuple[float, float], diameter: float) -> str:
        cx, cy = np.array(at) * flip
        place = f'cx="{cx:.{digits}f}" cy="{cy:.{digits}f}" r="{diameter / 2:.{digits}f}"'
        return f'<circle class="{kind}" {place}><title>{escape(name)}</title></circle>'

    frame = np.array(board.outline or (low, high), dtype=np.float64)
    if len(frame) == 2:
        (x0, y0), (x1, y1) = frame
        frame = np.array([[x0, y0], [x1, y0], [x1, y1], [x0, y1]])
    content = [
        path("board", [frame, *(np.array(c) for c in board.cut_outs or ())]),
        path("body", (board.footprint(c) for c in board.components if c.size_from != "guess")),
        path("guess", (board.footprint(c) for c in board.components if c.size_from == "guess")),
        *(dot("mark", f.name, (f.x, f.y), f.diameter) for f in board.fiducials),
        *(dot("other", f"{m.name} ({m.kind})", (m.x, m.y), m.diameter) for m in board.other_marks or ()),
    ]
    for c in board.components if len(board.components) <= MOST_LABELS else ():
        cx, cy = np.array(c.center) * flip
        font = 0.35 * min(c.width, c.height)
        content.append(
            f'<text x="{cx:.{digits}f}" y="{cy:.{digits}f}" font-size="{font:.{digits}f}" text-anchor="middle">'
            f"{escape(c.address)}</text>"
        )
    box = f"{x:.{digits}f} {y:.{digits}f} {width:.{digits}f} {height:.{digits}f}"
    title = f"<title>{escape(board.name)}, {board.side}</title><style>{_STYLE}</style>"
    return (
        f'<svg xmlns="http://www.w3.org/2000/svg" viewBox="{box}" width="900" '
        f'stroke-width="{0.001 * size:.{digits}f}">{title}{"".join(content)}</svg>'
    )
