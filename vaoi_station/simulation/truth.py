"""The truth about a passage in the format of truth.json; it only scores results and is never an input."""

from __future__ import annotations

from typing import Any

import numpy as np

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.simulation.board.layout import board_from_cad
from vaoi_station.simulation.imaging.pinholes import Pinhole
from vaoi_station.simulation.world import World


def passage_truth(twin: World, pinholes: tuple[Pinhole, ...], poses: list[Floats]) -> dict[str, Any]:
    """Return M_ij = N_i·D_j, C = E_0·(board from CAD), D_j = E_j·E_0⁻¹, heights, and where every footprint is seen.

    Args:
        twin: the board.
        pinholes: the cameras as they really hang.
        poses: E_j, tester from board, one per row.
    """
    planes = [p.plane() for p in pinholes]
    first = np.linalg.inv(poses[0])
    motions = [e @ first for e in poses]
    board = board_from_cad(twin.scenario.board)
    return {
        "image_matrices": [[(n @ d).tolist() for d in motions] for n in planes],
        "cad_matrix": (poses[0] @ board).tolist(),
        "row_motion": [d.tolist() for d in motions],
        "heights": {p.ref: p.body_height_mm for p in twin.parts},
        "views": views(twin, pinholes, poses),
    }


def views(twin: World, pinholes: tuple[Pinhole, ...], poses: list[Floats]) -> dict[str, list[list[float]]]:
    """Return the raw pixels of every footprint's centre, on the board's surface, in every frame that shows it."""
    if not twin.parts:
        return {}
    places = np.array([p.place for p in twin.parts])
    seen: dict[str, list[list[float]]] = {}
    for i, pinhole in enumerate(pinholes):
        limit = (pinhole.width_px - 1, pinhole.height_px - 1)
        for j, pose in enumerate(poses):
            pixels = pinhole.project(apply(pose, places), twin.scene.surface_z(places))
            # Bodies may hide a footprint; the truth is about geometry and ignores that.
            inside = ((pixels > 0) & (pixels < limit)).all(1)
            for k in np.flatnonzero(inside):
                u, v = pixels[k]
                seen.setdefault(twin.parts[k].ref, []).append([i, j, round(float(u), 4), round(float(v), 4)])
    return seen
