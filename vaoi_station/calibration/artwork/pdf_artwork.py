"""The board as PDF 1.4: one page of the board's size with vectors only, 1:1 if printed without "fit to page"."""

from __future__ import annotations

from vaoi_station.calibration.artwork.board_design import Board
from vaoi_station.calibration.artwork.drawing_elements import arrow, cross, label_baseline_mm, scale_bar
from vaoi_station.errors import InputError

_POINTS_PER_MM = 72 / 25.4
_MAX_POINTS = 14400
"""Largest page side of PDF 1.4 without a user unit: 200 inches (PDF Reference, appendix C)."""


def render_pdf(board: Board, title: str) -> bytes:
    """Render the artwork as a PDF file, with a title beside the scale bar.

    Raises:
        InputError: if the board is larger than the largest PDF page (5 m).
    """
    w, h = (v * _POINTS_PER_MM for v in board.size_mm)
    if max(w, h) > _MAX_POINTS:
        limit = f"at most {_MAX_POINTS / _POINTS_PER_MM:.0f} mm"
        raise InputError.field("calibration board", "length for PDF", f"{max(board.size_mm):.0f} mm", limit)
    content = _content(board, title, h).encode("latin-1", "replace")
    page = (
        f"<< /Type /Page /Parent 2 0 R /MediaBox [0 0 {w:.6f} {h:.6f}] /Contents 4 0 R "
        "/Resources << /Font << /F1 5 0 R >> >> >>"
    )
    return _document(
        [
            b"<< /Type /Catalog /Pages 2 0 R /ViewerPreferences << /PrintScaling /None >> >>",
            b"<< /Type /Pages /Kids [3 0 R] /Count 1 >>",
            page.encode(),
            b"<< /Length %d >>\nstream\n%s\nendstream" % (len(content), content),
            b"<< /Type /Font /Subtype /Type1 /BaseFont /Helvetica >>",
        ]
    )


def _content(board: Board, title: str, page_height: float) -> str:
    """Write the drawing operators of the page.

    `re f` fills the ground, `m l h f` fills each mark, `m l S` strokes the scale bar, and `Tj` writes the text.
    """
    # The transformation matrix (cm) maps mm with y down to points with y up, so marks keep their layout coordinates.
    (x, y), (w, h), mark, k = board.low_mm, board.size_mm, board.layout.mark, _POINTS_PER_MM
    ground, ink = (1, 0) if mark.polarity == "dark" else (0, 1)
    size, width = (v * board.layout.mm_per_unit for v in (mark.size, mark.width))
    strokes, length = scale_bar(board.low_mm, board.high_mm)
    lines = [
        "q",
        f"{k:.10f} 0 0 {-k:.10f} {-x * k:.7f} {page_height + y * k:.7f} cm",
        f"{ground} g {x:.6f} {y:.6f} {w:.6f} {h:.6f} re f",
        f"{ink} g {ink} G 0.2 w",
    ]
    for place in board.places_mm:
        first, *rest = (f"{u:.6f} {v:.6f}" for u, v in cross(place, size, width))
        lines.append(f"{first} m " + " ".join(f"{corner} l" for corner in rest) + " h f")
    drawn = [*strokes, *arrow(board.low_mm, board.high_mm, board.camera_x_mm[0])]
    lines += [f"{a[0]:.6f} {a[1]:.6f} m {b[0]:.6f} {b[1]:.6f} l S" for a, b in drawn]
    end = ((strokes[0, 1] - (x, y)) * k).tolist()
    text = f"{length:g} mm  {title}".replace("\\", r"\\").replace("(", r"\(").replace(")", r"\)")
    # The text is written in points after Q has restored the matrix, because the flipped matrix would mirror it.
    lines += ["Q", f"{ink} g", f"BT /F1 7.5 Tf {end[0] + 6:.3f} {page_height - end[1] - 3:.3f} Td ({text}) Tj ET"]
    down = page_height - (label_baseline_mm(board.high_mm) - y) * k
    for i, at in enumerate(board.camera_x_mm):
        name = f"camera {i}"
        # Half of the text's width: the letters of Helvetica are half as wide as they are high.
        lines.append(f"BT /F1 7.5 Tf {(at - x) * k - 7.5 * len(name) / 4:.3f} {down:.3f} Td ({name}) Tj ET")
    return "\n".join(lines)


def _document(objects: list[bytes]) -> bytes:
    """Assemble a document: objects numbered from 1, the cross-reference table of their offsets, and the trailer."""
    out, offsets = b"%PDF-1.4\n%\xe2\xe3\xcf\xd3\n", []
    for number, content in enumerate(objects, start=1):
        offsets.append(len(out))
        out += b"%d 0 obj\n%s\nendobj\n" % (number, content)
    table = b"".join(b"%010d 00000 n \n" % offset for offset in offsets)
    count = len(objects) + 1
    return out + (
        b"xref\n0 %d\n0000000000 65535 f \n%strailer\n<< /Size %d /Root 1 0 R >>\nstartxref\n%d\n%%%%EOF\n"
        % (count, table, count, len(out))
    )
