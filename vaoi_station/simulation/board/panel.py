"""The boards of a simulated panel: their poses by CAD data and in reality, and their marks.

Board coordinates of the panel and of each of its boards: mm, origin in the top left corner as the camera sees it, x
right, y down. Positions are named "1", "2", … in the order of the scenario.
"""

from __future__ import annotations

import math
from typing import NamedTuple

import numpy as np

from vaoi_station.geometry.transforms import Floats, apply
from vaoi_station.simulation.scenario import FiducialMark, Look, PanelBoardSection, PanelSection


class BadMark(NamedTuple):
    """The bad-board mark of one board: its position on the panel, its look, and its looks on good and bad boards.

    Half of it may look otherwise.
    """

    x_mm: float
    y_mm: float
    diameter_mm: float
    good: Look
    bad: Look
    look: Look
    half: Look


def nominal_poses(panel: PanelSection) -> dict[str, Floats]:
    """Return the matrix (3, 3) from board to panel of every board by its position, as CAD data state it."""
    return {str(n + 1): _nominal(panel, board) for n, board in enumerate(panel.boards)}


def real_poses(panel: PanelSection) -> dict[str, Floats]:
    """Return the matrix (3, 3) from board to panel of every board by its position, as it really lies."""
    nominal = nominal_poses(panel)
    return {position: displacement @ nominal[position] for position, displacement in moves(panel).items()}


def moves(panel: PanelSection) -> dict[str, Floats]:
    """Return the displacement (3, 3) of every board from its place by CAD data, in panel coordinates."""
    out = {}
    for n, board in enumerate(panel.boards):
        middle = apply(_nominal(panel, board), np.array([panel.width_mm / 2, panel.length_mm / 2]))
        turn = _turn(board.turn_deg)
        turn[:2, 2] = middle + board.shift_mm - turn[:2, :2] @ middle
        out[str(n + 1)] = turn
    return out


def marks_at(panel: PanelSection, poses: dict[str, Floats]) -> dict[str, tuple[FiducialMark, ...]]:
    """Return the fiducials of every board by its position, at their places on the panel."""
    return {
        position: tuple(
            mark.model_copy(update=dict(zip(("x_mm", "y_mm"), _at(pose, mark.x_mm, mark.y_mm), strict=True)))
            for mark in panel.fiducials
        )
        for position, pose in poses.items()
    }


def bad_marks_at(panel: PanelSection, poses: dict[str, Floats]) -> dict[str, BadMark]:
    """Return the bad-board mark of every board by its position; empty if the boards have none."""
    mark = panel.bad_mark
    if mark is None:
        return {}
    looks = {"good": (mark.good, mark.good), "bad": (mark.bad, mark.bad), "half": (mark.good, mark.bad)}
    return {
        position: BadMark(*_at(pose, mark.x_mm, mark.y_mm), mark.diameter_mm, mark.good, mark.bad, *looks[board.mark])
        for (position, pose), board in zip(poses.items(), panel.boards, strict=True)
    }


def _nominal(panel: PanelSection, board: PanelBoardSection) -> Floats:
    pose = _turn(board.rotated_deg)
    corners = np.array([[0, 0], [panel.width_mm, 0], [panel.width_mm, panel.length_mm], [0, panel.length_mm]])
    pose[:2, 2] = np.array([board.x_mm, board.y_mm]) - (corners @ pose[:2, :2].T).min(0)
    return pose


def _turn(deg: float) -> Floats:
    """Return the rotation (3, 3) by an angle counter-clockwise as the camera sees it, with y down."""
    c, s = math.cos(math.radians(deg)), math.sin(math.radians(deg))
    return np.array([[c, s, 0.0], [-s, c, 0.0], [0.0, 0.0, 1.0]])


def _at(pose: Floats, x: float, y: float) -> tuple[float, float]:
    u, v = apply(pose, np.array([x, y])).tolist()
    return u, v
