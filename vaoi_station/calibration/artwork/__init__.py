"""Artwork of calibration boards for an array, as SVG, PDF and Gerber; section 3.2 of the paper.

The axes of the layout are those of the frames: x to the right, y down. In file formats whose y axis points up, y is
negated, so that frames show the printed board as the layout describes it.
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
