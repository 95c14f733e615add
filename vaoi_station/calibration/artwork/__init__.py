"""Artwork of calibration boards, tailored to an array, as SVG, PDF and Gerber; section 3.2 of the paper.

Coordinates of the layout are those the cameras see: x to the right, y down. Formats whose y points up get −y, so
that the print looks to the camera as the layout says.
"""

from vaoi_station.calibration.artwork.board_design import ArrayDesign, Board, design_board
from vaoi_station.calibration.artwork.gerber_artwork import render_gerber_marks, render_gerber_outline
from vaoi_station.calibration.artwork.pdf_artwork import render_pdf
from vaoi_station.calibration.artwork.svg_artwork import render_svg

__all__ = [
    "ArrayDesign",
    "Board",
    "design_board",
    "render_gerber_marks",
    "render_gerber_outline",
    "render_pdf",
    "render_svg",
]
