"""The truth of a passage in the format of truth.json. Results are compared with it; it is never an input of them."""

from __future__ import annotations

from collections.abc import Collection
from typing import Any

import numpy as np

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.simulation.board.layout import board_from_cad
from vaoi_station.simulation.board.panel import moves
from vaoi_station.simulation.imaging.pinholes import Pinhole
from vaoi_station.simulation.world import World


def passage_truth(
    twin: World, pinholes: tuple[Pinhole, ...], poses: list[Floats], absent: Collection[str]
) -> dict[str, Any]:
    """Compute the truth of a passage: matrices, component heights, and the pixels of all footprints.

    With E_j = tester_from_board in row j, D_j = E_j·E_0⁻¹, M_ij = N_i·D_j and C = E_0·board_from_cad.

    Args:
        twin: the world of the scenario.
        pinholes: the cameras as they are during the passage.
        poses: E_j (3, 3), one per row.
        absent: names of the parts that are not on this board; their height is 0.
    """
    planes = [p.plane() for p in pinholes]
    first = np.linalg.inv(poses[0])
    motions = [e @ first for e in poses]
    board, panel = board_from_cad(twin.scenario.board), twin.scenario.board.panel
    displaced = {} if panel is None else moves(panel)
    of_boards = {position: (poses[0] @ move @ board).tolist() for position, move in displaced.items()}
    return {
        "image_matrices": [[(n @ d).tolist() for d in motions] for n in planes],
        "cad_matrix": (poses[0] @ board).tolist(),
        "row_motion": [d.tolist() for d in motions],
        "heights": {p.ref: 0.0 if p.ref in absent else p.body_height_mm for p in twin.parts},
        "views": views(twin, pinholes, poses),
    } | ({"board_matrices": of_boards} if of_boards else {})


def views(twin: World, pinholes: tuple[Pinhole, ...], poses: list[Floats]) -> dict[str, list[list[float]]]:
    """Return where the centre of each footprint appears in each frame that shows it.

    The keys are the names of parts. Each entry is [camera, row, x, y] in raw pixels of the centre, which
    lies on the board's surface.
    """
    if not twin.parts:
        return {}
    places = np.array([p.place for p in twin.parts])
    seen: dict[str, list[list[float]]] = {}
    for i, pinhole in enumerate(pinholes):
        limit = (pinhole.width_px - 1, pinhole.height_px - 1)
        for j, pose in enumerate(poses):
            pixels = pinhole.project(apply(pose, places), twin.scene.surface_z(places))
            # A body may hide the centre of a footprint. The truth describes the geometry only and ignores this.
            inside = ((pixels > 0) & (pixels < limit)).all(1)
            for k in np.flatnonzero(inside):
                u, v = pixels[k]
                seen.setdefault(twin.parts[k].ref, []).append([i, j, round(float(u), 4), round(float(v), 4)])
    return seen
