from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.model import BoardType, Component, Status, Stitch, Surface
from vaoi_station.model.stitch_result import BodyHeight, body_height, known_height_mm

M = np.diag([40.0, 40, 1])


def stitch(**change: Any) -> Stitch:
    base: dict[str, Any] = {
        "method": "m",
        "image_matrices": ((M, None),),
        "cad_matrix": np.diag([25.4, -25.4, 1]),
        "row_motion": (np.eye(3), np.eye(3)),
        "status": Status.OK,
    }
    return Stitch.model_validate(base | change)


def test_a_bow_is_quadratic_and_held_constant_outside_the_board() -> None:
    surface = Surface(lift_mm=0.0, bow_mm=(1.0, 0.5, 0.25))
    cad = np.array([[0.5, 0.0], [0.0, 0.5], [0.5, 0.5], [1.2, 0.0], [50.0, 0.0]])
    np.testing.assert_allclose(surface.height_mm(cad), [0.25, 0.0625, 0.25 + 0.125 + 0.0625, 1.44, 1.44])


def test_components_follow_their_board_and_their_local_fiducials() -> None:
    shifted = [np.array([[1.0, 0.0, x], [0.0, 1.0, 0.0], [0.0, 0.0, 1.0]]) for x in (0.0, 0.1, 0.2)]
    panel = stitch(cad_matrix=shifted[0], board_matrices={"A": shifted[1]}, local_matrices={"A/U2": shifted[2]})
    assert panel.component_matrix("A/U1") == pytest.approx(shifted[1])
    assert panel.component_matrix("A/U2") == pytest.approx(shifted[2])
    assert panel.component_matrix("B/U1") is panel.component_matrix("A") is panel.cad_matrix
    moves = panel.displacements(["A/U1", "A/U2", "B/U1", "U3"])
    assert {ref: move[0, 2] for ref, move in moves.items()} == {"A/U1": 0.1, "A/U2": 0.2}
    assert stitch().displacements(["U1"]) == {}


U1 = Component(ref="U1", center=(5, 5), width=2, height=2)
NOMINAL = U1.model_copy(update={"body_height": 0.1})


def board(**options: Any) -> BoardType:
    data = {"name": "b", "outline": [[0, 0], [40, 30]], "fiducials": []}
    return BoardType.model_validate(data | options)


def result(quality: dict[str, Any]) -> Stitch:
    return Stitch(
        method="test", image_matrices=(), cad_matrix=None, row_motion=(), status=Status.FAILED, quality=quality
    )


def measured(height: Any, sigma: Any) -> Stitch:
    return result({"heights_mm": {"U1": height}, "height_sigma_mm": {"U1": sigma}})


@pytest.mark.parametrize(
    ("height", "sigma", "expected"),
    [(1.2, 0.05, 1.2), (0.1, 0.05, 0.0), (1.2, 0.5, 0.0), (None, 0.1, 0.0), (1.0, None, 0.0), (True, 0.1, 0.0)],
)
def test_a_measured_height_counts_if_it_is_sure(height: Any, sigma: Any, expected: float) -> None:
    assert known_height_mm(U1, board(), measured(height, sigma)) == expected


def test_a_sure_measurement_comes_before_the_board_type() -> None:
    """The board may have another part than its CAD data state, or none."""
    assert body_height(NOMINAL, board(unit="inch"), measured(1.2, 0.05)) == BodyHeight(1.2, 0.05, "measured")
    assert known_height_mm(NOMINAL, board(unit="inch"), measured(1.2, 0.05)) == 1.2
    assert known_height_mm(NOMINAL, board(unit="inch"), measured(0.01, 0.02)) == 0, "the part is missing"
