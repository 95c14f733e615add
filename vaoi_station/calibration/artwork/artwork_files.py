"""The files of the artwork of one calibration board, and the array of a station for which it is made."""

from __future__ import annotations

from collections.abc import Callable, Sequence

import numpy as np

from vaoi_station.calibration.artwork.board_design import Board
from vaoi_station.calibration.artwork.gerber_artwork import render_gerber_marks, render_gerber_outline
from vaoi_station.calibration.artwork.pdf_artwork import render_pdf
from vaoi_station.calibration.artwork.svg_artwork import render_svg
from vaoi_station.model import CameraHead

RENDERERS: dict[str, Callable[[Board, str], bytes]] = {
    "calibration-board.svg": lambda board, title: render_svg(board, title).encode(),
    "calibration-board.pdf": render_pdf,
    "calibration-board.gbr": lambda board, _: render_gerber_marks(board).encode(),
    "calibration-board-outline.gbr": lambda board, _: render_gerber_outline(board).encode(),
}
"""For each file of the artwork, the function that makes it of a board and a title."""


def artwork_title(board: Board, pitch_mm: float) -> str:
    """Return the line of text below the views."""
    return f"{len(board.camera_x_mm)} x {pitch_mm:g} mm, {len(board.layout.marks)} marks"


def array_of(
    heads: Sequence[CameraHead], px_per_mm: float | None = None
) -> tuple[float | None, tuple[float, float] | None]:
    """Return the distance of neighbouring cameras and the field of view (mm) by nominal values; None: they are missing.

    A given resolution replaces the nominal ones.
    """
    centers = [c.nominal_center_mm for c in heads]
    pitch = None
    if len(heads) > 1 and None not in centers:
        pitch = float(np.hypot(*np.diff(np.array(centers, dtype=np.float64), axis=0).T).max())
    # The camera of the finest resolution sees least. If one resolution is unknown, the option must give the field.
    resolutions = [c.nominal_px_per_mm or 0.0 for c in heads]
    r = px_per_mm or (max(resolutions) if all(resolutions) else 0.0)
    # The smallest frame: the same marks must fit into the view of every camera.
    small = min(c.width for c in heads), min(c.height for c in heads)
    return pitch, (small[0] / r, small[1] / r) if r else None
