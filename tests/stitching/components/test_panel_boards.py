"""Places of the boards of a panel by their fiducials, from known displacements."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest
from hypothesis import given, settings
from hypothesis import strategies as st

from vaoi_station.geometry import apply
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.problem import FiducialPoints
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.board.fiducials import LOCAL_MM
from vaoi_station.stitching.components.places import OwnPlaces, board_places, own_places

C = np.array([[0.0, 1.0, 5.0], [1.0, 0.0, -2.0], [0, 0, 1]])
PX_PER_MM = 20.0
OF_BOARDS = {"A": (2, 3), "B": (4, 5)}


def panel(of_panel: int = 2) -> BoardType:
    """A panel of two boards with two fiducials each, and up to two fiducials of its own, all in one unit, mm."""
    own = [{"name": f"P{n}", "x": x, "y": 2, "diameter": 1} for n, x in enumerate((2, 98))]
    corners = {"A": [(6, 6), (44, 34)], "B": [(56, 6), (94, 34)]}
    boards = [
        {"name": f"{at}{n}", "x": x, "y": y, "diameter": 1, "panel": at}
        for at, places in corners.items()
        for n, (x, y) in enumerate(places)
    ]
    parts = [
        {"ref": f"U{n}", "panel": at, "center": [x0 + dx, 10 + dx / 2], "width": 4, "height": 4}
        for at, x0 in (("A", 10), ("B", 60))
        for n, dx in enumerate((0, 30))
    ]
    parts.append({"ref": "U1", "center": [50, 20], "width": 2, "height": 2})
    return BoardType.model_validate({"name": "b", "fiducials": own[:of_panel] + boards, "components": parts})


def places(off: dict[int, tuple[float, float]], noise_px: float = 0.0) -> OwnPlaces:
    """Places of the boards if fiducials, by number, lie `off` mm from C; all others of the boards are not found."""
    numbers = [0, 1, *off]
    which = np.repeat(np.array(numbers), 5)
    off_mm = np.array([off.get(n, (0.0, 0.0)) for n in which.tolist()])
    k, random = len(which), np.random.default_rng(2)
    residual = off_mm * PX_PER_MM + random.normal(0, noise_px, (k, 2))
    sigma, lean = np.hypot(np.full(k, 0.02 / PX_PER_MM), np.where(which > 1, LOCAL_MM, 0.0)), np.zeros((k, 2))
    points = FiducialPoints(which * 0, lean, lean, lean, sigma, np.full(k, PX_PER_MM), which, which * 0)
    adjusted: Any = SimpleNamespace(fiducial_px=residual)
    return own_places(BoardPlane(panel(), True), adjusted, points, C)


def displaced(position: str, shift: tuple[float, float], turn_deg: float) -> dict[int, tuple[float, float]]:
    """Displacements of the fiducials of a board that is turned about the origin and shifted."""
    at = apply(C, np.array([(panel().fiducials[n].x, panel().fiducials[n].y) for n in OF_BOARDS[position]]))
    off = apply(move(shift, turn_deg), at) - at
    return dict(zip(OF_BOARDS[position], [(float(x), float(y)) for x, y in off], strict=True))


def move(shift: tuple[float, float], turn_deg: float) -> Floats:
    a = np.radians(turn_deg)
    middle = np.array([25.0, 25.0])
    matrix = np.array([[np.cos(a), -np.sin(a), 0.0], [np.sin(a), np.cos(a), 0.0], [0, 0, 1]])
    matrix[:2, 2] = middle + shift - matrix[:2, :2] @ middle
    return matrix


_MM = st.floats(-0.25, 0.25)


@settings(max_examples=30, deadline=None)
@given(_MM, _MM, st.floats(-0.15, 0.15))
def test_shift_and_turn_of_a_board_are_those_of_its_fiducials(x: float, y: float, turn_deg: float) -> None:
    place = places(displaced("A", (x, y), turn_deg)).boards["A"]
    assert place.matrix is not None
    assert place.matrix == pytest.approx(move((x, y), turn_deg) @ C, abs=1e-5)
    assert place.turn_rad == pytest.approx(np.radians(turn_deg), abs=1e-6)
    assert place.off_mm < 1e-5


def test_large_and_contradicting_displacements_are_refused() -> None:
    far = places(displaced("A", (0.9, 0.9), 0.0)).boards["A"]
    assert (far.matrix, far.refusal) == (None, "A0, A1 would displace it by 1.27 mm (limit 1 mm)")
    apart = places({2: (0.2, 0.2), 3: (-0.2, -0.2)}).boards["A"]
    assert apart.matrix is None
    assert "from their places on it (limit 0.1 mm)" in apart.refusal


def test_fiducials_of_boards_have_no_part_in_c_beside_those_of_the_panel() -> None:
    board = panel()
    assert board.board_fiducials == OF_BOARDS
    assert board.apart_from_c({0, 1, 2, 3, 4, 5}) == {2, 3, 4, 5}
    # Without two of the panel, one board determines C, the one whose fiducials are farthest apart.
    # It does so alone: one fiducial of the panel would draw C away from the displaced board.
    assert board.apart_from_c({0, 2, 4, 5}) == {0, 2, 3}
    assert board.apart_from_c({0, 2, 4}) == frozenset()
    without = panel(of_panel=0)
    assert without.apart_from_c(range(4)) == {2, 3}
    # Fixture marks hold the panel, not one of its boards.
    assert without.apart_from_c(range(4), fixture_marks=2) == {0, 1, 2, 3}
    assert board.apart_from_c({0, 2, 4, 5}, fixture_marks=1) == {2, 3, 4, 5}
    assert without.apart_from_c(range(4), fixture_marks=1) == {2, 3}
    assert [without.board_of_c(range(4), fixture_marks=n) for n in (1, 2)] == ["A", None]


def test_the_board_that_determines_c_lies_where_c_puts_it() -> None:
    plane = BoardPlane(panel(of_panel=0), True)
    which = np.repeat(np.arange(4), 2)
    k, lean = len(which), np.zeros((len(which), 2))
    points = FiducialPoints(which * 0, lean, lean, lean, np.full(k, 0.5), np.full(k, PX_PER_MM), which, which * 0)
    adjusted: Any = SimpleNamespace(fiducial_px=np.where(which[:, None] > 1, 2.0, 0.0) * np.ones((1, 2)))
    found = board_places(plane, adjusted, points, C)
    assert found["A"].matrix is C
    assert found["B"].shift_mm == pytest.approx([0.1, 0.1])


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
