"""Contours inside the outermost one that hold the parts: the board in a frame, not a cut-out.

Drawings have a frame of a sheet or of a panel around the board, or the outline twice.
"""

from __future__ import annotations

from collections.abc import Sequence
from dataclasses import replace

import numpy as np

from vaoi_station.board_data.design import XY, Design, Part, noted, places
from vaoi_station.board_data.marks import all_marks
from vaoi_station.geometry.polygon import encloses


def without_frame(design: Design) -> Design:
    """Return the design with the contour that holds most of its parts as the outline, if it is not the outermost one.

    Fiducials on the frame, outside of that contour, show that the frame belongs to what is filmed: then it stays.
    """
    if not design.outline or not design.cut_outs or design.boards:
        return design
    held = parts_within(design.cut_outs, design.parts)
    board, count = max(zip(design.cut_outs, map(len, held), strict=True), key=lambda found: found[1])
    on_frame = (encloses(design.outline, m.at) and not encloses(board, m.at) for m in all_marks(design))
    if 2 * count <= len(design.parts) or any(on_frame):
        return design
    text = (
        "{count} of {all} parts lie within a contour inside the outermost one: it is taken as the outline, from {at} "
        "on, and the outermost one as a frame. Check the outline in the picture."
    )
    note = noted("frame-left-out", text, count=count, all=len(design.parts), at=places([min(board)]))
    # The contours inside the others belong to this board if they lie within it.
    cut_outs = tuple(c for c in design.islands if encloses(board, c[0]))
    notes = [n for n in design.notes if n.code != "islands-left-out" or not design.islands]
    return replace(design, outline=board, cut_outs=cut_outs, islands=(), notes=(*notes, note))


def parts_within(contours: Sequence[Sequence[XY]], parts: Sequence[Part]) -> list[list[Part]]:
    """Return for every contour the parts whose body has its centre in it."""
    centers = np.array([part.center for part in parts], dtype=np.float64).reshape(-1, 2)
    found = []
    for contour in contours:
        low, high = np.min(contour, axis=0), np.max(contour, axis=0)
        near = np.flatnonzero(((centers >= low) & (centers <= high)).all(axis=1)).tolist()
        found.append([parts[n] for n in near if encloses(contour, centers[n])])
    return found
