"""The board as Gerber (RS-274X): marks are flashes of one cross-shaped aperture, the outline is a separate file.

The y axis of Gerber points up: a mark at (x, y) of the layout is flashed at (x, −y), in mm with six decimals.
"""

from __future__ import annotations

from vaoi_station.calibration.artwork.board_design import Board
from vaoi_station.calibration.artwork.drawing_elements import scale_bar


def render_gerber_marks(board: Board) -> str:
    """Render the marks and the scale bar as a Gerber file."""
    # The layer is positive: what is drawn gets the polarity of the marks, light or dark.
    mark = board.layout.mark
    size, width = (v * board.layout.mm_per_unit for v in (mark.size, mark.width))
    strokes, _ = scale_bar(board.low_mm, board.high_mm)
    lines = [
        *_head("Other,Calibration marks"),
        "%AMCROSS*21,1,$1,$2,0,0,0*21,1,$2,$1,0,0,0*%",
        f"%ADD10CROSS,{size:.6f}X{width:.6f}*%",
        "%ADD11C,0.200000*%",
        "D10*",
        *(f"{_place(u, v)}D03*" for u, v in board.places_mm),
        "D11*",
    ]
    for (u0, v0), (u1, v1) in strokes:
        lines += [f"{_place(u0, v0)}D02*", f"{_place(u1, v1)}D01*"]
    return "\n".join([*lines, "M02*"]) + "\n"


def render_gerber_outline(board: Board) -> str:
    """Render the outline of the board as a Gerber file."""
    (x0, y0), (x1, y1) = board.low_mm, board.high_mm
    around = [(x1, y0), (x1, y1), (x0, y1), (x0, y0)]
    lines = [*_head("Profile,NP"), "%ADD10C,0.100000*%", "D10*", f"{_place(x0, y0)}D02*"]
    return "\n".join([*lines, *(f"{_place(x, y)}D01*" for x, y in around), "M02*"]) + "\n"


def _head(function: str) -> list[str]:
    return [f"%TF.FileFunction,{function}*%", "%FSLAX46Y46*%", "%MOMM*%", "%LPD*%", "G01*"]


def _place(x: float, y: float) -> str:
    return f"X{round(x * 1e6)}Y{round(-y * 1e6)}"
