"""The truth of a passage in the format of truth.json. Results are compared with it; it is never an input of them."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.simulation.board.layout import Part, board_from_cad, surface_z
from vaoi_station.simulation.board.panel import moves
from vaoi_station.simulation.imaging.pinholes import Pinhole
from vaoi_station.simulation.scenario import BoardSection


def passage_truth(
    section: BoardSection,
    parts: tuple[Part, ...],
    pinholes: tuple[Pinhole, ...],
    poses: list[Floats],
    absent: Collection[str],
) -> dict[str, Any]:
    """Return matrices, component heights, and the pixels of all footprints, given tester_from_board E_j of each row.

    D_j = E_j·E_0⁻¹, M_ij = N_i·D_j and C = E_0·board_from_cad. The parts named `absent` have the height 0.
    """
    planes = [p.plane() for p in pinholes]
    first = np.linalg.inv(poses[0])
    motions = [e @ first for e in poses]
    board, panel = board_from_cad(section), section.panel
    truth = {
        "image_matrices": [[(n @ d).tolist() for d in motions] for n in planes],
        "cad_matrix": (poses[0] @ board).tolist(),
        "row_motion": [d.tolist() for d in motions],
        "heights": {p.ref: 0.0 if p.ref in absent else p.body_height_mm for p in parts},
        "views": views(section, parts, pinholes, poses),
    }
    if panel is not None:
        truth["board_matrices"] = {name: (poses[0] @ move @ board).tolist() for name, move in moves(panel).items()}
    return truth


def views(
    section: BoardSection, parts: tuple[Part, ...], pinholes: tuple[Pinhole, ...], poses: list[Floats]
) -> dict[str, list[list[float]]]:
    """Return where the centre of each footprint, which lies on the board's surface, appears in the frames.

    The keys are the names of parts. Each entry is [camera, row, x, y] in raw pixels.
    """
    if not parts:
        return {}
    places = np.array([p.place for p in parts])
    seen: dict[str, list[list[float]]] = {}
    for i, pinhole in enumerate(pinholes):
        limit = (pinhole.width_px - 1, pinhole.height_px - 1)
        for j, pose in enumerate(poses):
            pixels = pinhole.project(apply(pose, places), surface_z(section, places))
            # A body may hide the centre of a footprint. The truth describes the geometry only and ignores this.
            for k in np.flatnonzero(((pixels > 0) & (pixels < limit)).all(1)):
                u, v = pixels[k]
                seen.setdefault(parts[k].ref, []).append([i, j, round(float(u), 4), round(float(v), 4)])
    return seen
