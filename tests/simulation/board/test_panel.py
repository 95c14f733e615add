"""Boards of a simulated panel: where CAD data put them, where they are, and their marks."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest
from pydantic import ValidationError

from vaoi_station.geometry import apply
from vaoi_station.simulation.board.layout import board_type, place_parts
from vaoi_station.simulation.board.panel import nominal_poses, real_poses
from vaoi_station.simulation.scenario import BoardSection, PanelSection


def panel(**of_board: Any) -> PanelSection:
    board = {"x_mm": 30.0, "y_mm": 5.0, "rotated_deg": 90, "mark": "half"} | of_board
    return PanelSection.model_validate(
        {
            "width_mm": 20.0,
            "length_mm": 12.0,
            "boards": [{"x_mm": 2.0, "y_mm": 3.0}, board],
            "fiducials": [{"x_mm": 1.0, "y_mm": 1.5}],
            "bad_mark": {"x_mm": 10.0, "y_mm": 6.0, "good": "blank", "bad": "dark"},
        }
    )


def section(**of_board: Any) -> BoardSection:
    return BoardSection(width_mm=60.0, length_mm=40.0, density=3.0, panel=panel(**of_board))


def test_boards_lie_where_cad_data_put_them_unless_they_are_displaced() -> None:
    poses = nominal_poses(panel())
    corners = np.array([[0.0, 0.0], [20.0, 12.0]])
    assert apply(poses["1"], corners) == pytest.approx(np.array([[2, 3], [22, 15]]))
    # Counter-clockwise as the camera sees it: the corner at the top left comes to the bottom left.
    assert apply(poses["2"], corners) == pytest.approx(np.array([[30, 25], [42, 5]]))
    assert real_poses(panel())["2"] == pytest.approx(poses["2"])


def test_cad_data_state_the_place_by_design_and_parts_the_real_one() -> None:
    displaced, design = section(shift_mm=[0.2, 0.0]), section()
    assert board_type(displaced, place_parts(displaced)) == board_type(design, place_parts(design))
    off = {
        p.ref: np.subtract(p.place, q.place) for p, q in zip(place_parts(displaced), place_parts(design), strict=True)
    }
    assert {ref.partition("/")[0] for ref in off} == {"1", "2"}
    for ref, by in off.items():
        assert by == pytest.approx([0.2, 0.0] if ref.startswith("2/") else [0.0, 0.0])
    board = board_type(design, place_parts(design))
    assert board.board_fiducials == {"1": (3,), "2": (4,)}
    assert {c.address for c in board.components} == set(off)


def test_a_board_off_its_panel_is_refused() -> None:
    with pytest.raises(ValidationError, match="lies off the panel of 60"):
        section(x_mm=45.0, rotated_deg=0)
    with pytest.raises(ValidationError, match="together with file"):
        BoardSection(width_mm=60.0, length_mm=40.0, grid_mm=5.0, panel=panel())
