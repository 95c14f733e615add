"""The board as SVG: user units are mm, and width and height of the document give a scale of 1:1."""

from __future__ import annotations

from xml.sax.saxutils import escape

from vaoi_station.calibration.artwork.board_design import Board
from vaoi_station.calibration.artwork.drawing_elements import arrow, cross, label_baseline_mm, scale_bar


def render_svg(board: Board, title: str) -> str:
    """Render the artwork as an SVG document in layout coordinates, with a title below the views."""
    (x, y), (w, h), mark = board.low_mm, board.size_mm, board.layout.mark
    dark = mark.polarity == "dark"
    ground, ink = ("#ffffff", "#000000") if dark else ("#000000", "#ffffff")
    size, width = (v * board.layout.mm_per_unit for v in (mark.size, mark.width))
    strokes, length = scale_bar(board.low_mm, board.high_mm)
    lines = [
        '<?xml version="1.0" encoding="UTF-8"?>',
        f'<svg xmlns="http://www.w3.org/2000/svg" width="{w:.6g}mm" height="{h:.6g}mm" '
        f'viewBox="{x:.6g} {y:.6g} {w:.6g} {h:.6g}">',
        f"<title>{escape(title)}</title>",
        f'<rect id="board" x="{x:.6g}" y="{y:.6g}" width="{w:.6g}" height="{h:.6g}" fill="{ground}"/>',
        f'<g id="marks" fill="{ink}">',
    ]
    for place in board.places_mm:
        corners = " L".join(f"{u:.6f} {v:.6f}" for u, v in cross(place, size, width))
        lines.append(f'<path d="M{corners} Z"/>')
    lines += ["</g>", f'<g id="scale" stroke="{ink}" stroke-width="0.2" fill="none">']
    lines += [f'<path d="M{a[0]:.6f} {a[1]:.6f} L{b[0]:.6f} {b[1]:.6f}"/>' for a, b in strokes]
    end = strokes[0, 1]
    lines += [
        "</g>",
        f'<text x="{end[0] + 2:.3f}" y="{end[1] + 1:.3f}" font-family="sans-serif" font-size="2.6" fill="{ink}">'
        f"{length:g} mm  {escape(title)}</text>",
        f'<g id="cameras" stroke="{ink}" stroke-width="0.3" fill="none">',
    ]
    lines += [
        f'<path d="M{a[0]:.6f} {a[1]:.6f} L{b[0]:.6f} {b[1]:.6f}"/>'
        for a, b in arrow(board.low_mm, board.high_mm, board.camera_x_mm[0])
    ]
    baseline = label_baseline_mm(board.high_mm)
    lines += [
        "</g>",
        *(
            f'<text x="{at:.3f}" y="{baseline:.3f}" font-family="sans-serif" font-size="2.6" text-anchor="middle" '
            f'fill="{ink}">camera {i}</text>'
            for i, at in enumerate(board.camera_x_mm)
        ),
        "</svg>",
    ]
    return "\n".join(lines) + "\n"
