from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.geometry import apply
from vaoi_station.simulation.board.layout import board_from_cad, board_type, place_parts
from vaoi_station.simulation.scenario import BoardSection

UNITS = [("mm", "up", "top"), ("inch", "down", "top"), ("mil", "up", "bottom"), ("mm", "down", "bottom")]


def test_equal_seeds_make_equal_boards_and_others_do_not() -> None:
    assert place_parts(BoardSection()) == place_parts(BoardSection())
    assert place_parts(BoardSection(seed=6)) != place_parts(BoardSection())


@pytest.mark.parametrize(("unit", "y_axis", "side"), UNITS)
def test_cad_description_matches_the_board(unit: str, y_axis: str, side: str) -> None:
    section = BoardSection.model_validate({"unit": unit, "y_axis": y_axis, "side": side})
    parts = place_parts(section)
    described = board_type(section, parts)
    matrix = board_from_cad(section)
    assert (np.linalg.det(matrix) < 0) == described.mirrors
    assert described.mm_per_unit == pytest.approx(np.sqrt(abs(np.linalg.det(matrix[:2, :2]))))
    for part, component in zip(parts, described.components, strict=True):
        assert np.allclose(apply(matrix, component.center), part.place, atol=1e-6)
        w, h = part.package.size
        corners = part.to_board(np.array([[-w, -h], [w, -h], [w, h], [-w, h]]) / 2)
        described_corners = apply(matrix, described.footprint(component))
        assert {tuple(c) for c in np.round(described_corners, 4) + 0.0} == {
            tuple(c) for c in np.round(corners, 4) + 0.0
        }
        assert component.body_height is not None
        assert component.body_height * described.mm_per_unit == pytest.approx(part.body_height_mm)
    for mark, fiducial in zip(section.marks, described.fiducials, strict=True):
        assert np.allclose(apply(matrix, (fiducial.x, fiducial.y)), (mark.x_mm, mark.y_mm), atol=1e-6)
