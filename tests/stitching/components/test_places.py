"""Places of boards and components that do not follow C, together."""

from __future__ import annotations

from types import SimpleNamespace
from typing import Any

import numpy as np
import pytest

from vaoi_station.geometry import apply
from vaoi_station.geometry.transforms import Floats
from vaoi_station.model import BoardType
from vaoi_station.stitching.adjustment.problem import FiducialPoints
from vaoi_station.stitching.board.board_plane import BoardPlane
from vaoi_station.stitching.board.fiducials import LOCAL_MM
from vaoi_station.stitching.components.places import (
    OwnPlace,
    common_displacement_mm,
    local_places,
)

C = np.array([[0.0, 1.0, 5.0], [1.0, 0.0, -2.0], [0, 0, 1]])
PX_PER_MM = 20.0


def board(count: int) -> BoardType:
    """A board of two components, one of which has `count` local fiducials around it."""
    places = [(26.0, 14.0), (34.0, 26.0)][:count]
    local = [
        {"name": f"L{n}", "x": x, "y": y, "diameter": 1, "kind": "local", "components": ["U1"]}
        for n, (x, y) in enumerate(places)
    ]
    two = [{"name": "F1", "x": 2, "y": 2, "diameter": 1}, {"name": "F2", "x": 58, "y": 38, "diameter": 1}]
    parts = [{"ref": ref, "center": at, "width": 4, "height": 4} for ref, at in (("U1", [30, 20]), ("U2", [50, 20]))]
    return BoardType.model_validate({"name": "b", "fiducials": [*two, *local], "components": parts})


def seen(off_mm: list[tuple[float, float]], noise_px: float) -> tuple[FiducialPoints, Any]:
    """Five views of each local fiducial, which lie `off_mm` from C: the points, and the adjustment with residuals."""
    which = np.repeat(np.arange(len(off_mm)) + 2, 5)
    random = np.random.default_rng(2)
    residual = np.array(off_mm).reshape(-1, 2)[which - 2] * PX_PER_MM + random.normal(0, noise_px, (len(which), 2))
    k = len(which)
    sigma, lean = np.full(k, np.hypot(noise_px / PX_PER_MM, LOCAL_MM)), np.zeros((k, 2))
    points = FiducialPoints(which * 0, lean, lean, lean, sigma, np.full(k, PX_PER_MM), which, which * 0)
    return points, SimpleNamespace(fiducial_px=residual)


def placed(count: int, off_mm: list[tuple[float, float]], noise_px: float = 0.02) -> dict[str, OwnPlace]:
    """Places of components if the local fiducials lie `off_mm` from C."""
    points, adjusted = seen(off_mm, noise_px)
    return local_places(BoardPlane(board(count), True), adjusted, points, C, {})


def at_center(place: OwnPlace) -> Floats:
    assert place.matrix is not None
    return np.asarray(apply(place.matrix, np.array([30.0, 20.0])) - apply(C, np.array([30.0, 20.0])))


def test_two_local_fiducials_turn_their_component_too() -> None:
    turn = 0.004
    arms = np.array([(-6.0, -4.0), (6.0, 4.0)])  # about the component, tester coordinates
    off = [(0.03 - turn * y, -0.02 + turn * x) for x, y in arms.tolist()]
    place = placed(2, off)["U1"]
    assert place.turn_rad == pytest.approx(turn, abs=3e-4)
    assert at_center(place) == pytest.approx([0.03, -0.02], abs=4 * place.sigma_mm)


def test_large_and_contradicting_displacements_are_refused() -> None:
    far = placed(1, [(0.3, 0.2)])["U1"]
    assert far.matrix is None
    assert far.refusal == "L0 would displace it by 0.36 mm (limit 0.3 mm)"
    apart = placed(2, [(0.15, 0.1), (-0.15, -0.1)])["U1"]
    assert apart.matrix is None
    assert "disagree" in apart.refusal
    lost = placed(2, [])["U1"]
    assert (lost.refusal, lost.lost) == ("L0, L1 was not found", ("L0", "L1"))


@pytest.mark.parametrize(
    ("off_mm", "common"),
    [
        ([(0.1, 0.0), (0.1, 0.0), (0.15, 0.0), (0.15, 0.0)], True),
        ([(0.02, 0.0), (0.02, 0.0), (-0.01, 0.02), (-0.01, 0.02)], False),
        ([(0.0, 0.0), (0.0, 0.0), (0.0, 0.0), (0.0, 0.15)], False),
        ([(0.1, 0.0), (0.1, 0.0)], False),
    ],
)
def test_local_fiducials_of_several_components_show_an_error_of_c(
    off_mm: list[tuple[float, float]], common: bool
) -> None:
    marks = [f.model_dump(exclude_none=True) for f in board(2).fiducials]
    more = [
        {"name": f"L{n + 2}", "x": x, "y": y, "diameter": 1, "kind": "local", "components": ["U2"]}
        for n, (x, y) in enumerate([(46.0, 14.0), (54.0, 26.0)])
    ]
    data = board(2).model_dump(exclude_none=True) | {"fiducials": [*marks, *more]}
    plane = BoardPlane(BoardType.model_validate(data), True)
    points, adjusted = seen(off_mm, noise_px=0.02)
    found = common_displacement_mm(plane, adjusted, points, C)
    assert found == (pytest.approx(0.13, abs=0.01) if common else 0.0)
