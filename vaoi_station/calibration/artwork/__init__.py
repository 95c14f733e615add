"""Artwork of calibration boards, tailored to an array, as SVG, PDF and Gerber; section 3.2 of the paper.

Coordinates of the layout are those the cameras see: x to the right, y down. Formats whose y points up get −y, so
that the print looks to the camera as the layout says.
"""

from vaoi_station.calibration.artwork.design import ArrayDesign, Board, design_board
from vaoi_station.calibration.artwork.gerber import gerber_marks, gerber_outline
from vaoi_station.calibration.artwork.pdf import pdf
from vaoi_station.calibration.artwork.svg import svg

__all__ = ["ArrayDesign", "Board", "design_board", "gerber_marks", "gerber_outline", "pdf", "svg"]
