"""Places of boards and components that do not follow C, together."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from tests.stitching.components.test_panel_boards import PX_PER_MM, C, panel
from vaoi_station.geometry import apply
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.problem import FiducialPoints
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.board.fiducials import LOCAL_MM
from vaoi_station.stitching.components.places import own_places


def test_local_fiducials_place_their_component_on_a_displaced_board() -> None:
    """The board lies 0.4 mm from C: more than a local fiducial may displace its component."""
    data = panel().model_dump(exclude_none=True)
    local = {"name": "L", "x": 12.0, "y": 12.0, "diameter": 1, "kind": "local", "components": ["A/U0"], "panel": "A"}
    data["fiducials"] = [*data["fiducials"], local]
    plane = BoardPlane(BoardType.model_validate(data), True)
    which = np.repeat(np.arange(7), 5)
    board, part = np.array([0.4, 0.0]), np.array([0.05, -0.02])
    off = np.where(((which == 2) | (which == 3) | (which == 6))[:, None], board, 0.0)
    off = off + np.where((which == 6)[:, None], part, 0.0)
    k, lean = len(which), np.zeros((len(which), 2))
    points = FiducialPoints(which * 0, lean, lean, lean, np.full(k, LOCAL_MM), np.full(k, PX_PER_MM), which, which * 0)
    adjusted: Any = SimpleNamespace(fiducial_px=off * PX_PER_MM)
    found = own_places(plane, adjusted, points, C)
    assert found.local["A/U0"].refusal == ""
    center = np.array([10.0, 10.0])
    assert apply(found.matrices["A/U0"], center) - apply(C, center) == pytest.approx(board + part)
    assert apply(found.matrices["A/U1"], center) - apply(C, center) == pytest.approx(board)
    assert set(found.sigma_mm) == {"A/U0", "A/U1", "B/U0", "B/U1"}


def test_a_board_without_such_fiducials_has_no_own_places() -> None:
    data = panel().model_dump(exclude_none=True)
    data["fiducials"] = data["fiducials"][:2]
    adjusted: Any = SimpleNamespace(fiducial_px=np.zeros((0, 2)))
    found = own_places(BoardPlane(BoardType.model_validate(data), True), adjusted, FiducialPoints.empty(), C)
    assert not any(vars(found).values())
