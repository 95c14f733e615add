from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.geometry import apply
from vaoi_station.simulation.board.layout import board_from_cad, board_type, mounting_holes, place_parts
from vaoi_station.simulation.scenario import BoardSection

UNITS = [("mm", "up", "top"), ("inch", "down", "top"), ("mil", "up", "bottom"), ("mm", "down", "bottom")]


def test_parts_stand_apart_and_on_the_board() -> None:
    section = BoardSection()
    parts = place_parts(section)
    assert len(parts) > 80
    assert {"U1", "R1", "C1"} <= {p.ref for p in parts}
    boxes = np.array([[*p.place, *p.half_extent] for p in parts])
    assert (boxes[:, :2] - boxes[:, 2:] > 0).all()
    assert (boxes[:, :2] + boxes[:, 2:] < [section.width_mm, section.length_mm]).all()
    for n, a in enumerate(boxes):
        gap = np.abs(boxes[n + 1 :, :2] - a[:2]) - boxes[n + 1 :, 2:] - a[2:]
        assert (gap.max(1) > 0.3).all()


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


def test_parts_keep_clear_of_fiducials_and_holes() -> None:
    section = BoardSection(width_mm=60.0, length_mm=50.0, density=6.0)
    free = [((m.x_mm, m.y_mm), 1.1 * m.diameter_mm) for m in section.marks]
    free += [(hole, 2.3) for hole in mounting_holes(section)]
    for part in place_parts(section):
        for center, radius in free:
            gap = np.abs(np.subtract(part.place, center)) - part.half_extent
            assert gap.max() > radius


@pytest.mark.parametrize(("density", "height_scale"), [(0.0, 1.0), (1.0, 0.0), (3.0, 2.5)])
def test_density_and_heights_follow_the_scenario(density: float, height_scale: float) -> None:
    section = BoardSection(density=density, height_scale=height_scale)
    parts = place_parts(section)
    assert len(parts) <= round(density * section.width_mm * section.length_mm / 100)
    assert len(parts) >= 0.8 * density * section.width_mm * section.length_mm / 100 - 1
    for part in parts:
        assert part.body_height_mm == pytest.approx(part.package.body_height * height_scale, abs=1e-4)


def test_a_grid_has_equal_parts_that_cover_no_mark() -> None:
    section = BoardSection(grid_mm=2.5, width_mm=60.0, length_mm=40.0)
    parts = place_parts(section)
    places = np.array([part.place for part in parts])
    assert {part.package.name for part in parts} == {"LED"}
    assert {part.turned_deg for part in parts} == {0.0}
    steps = (places - places[0]) / 2.5
    assert np.allclose(steps, np.rint(steps))
    assert len(parts) > 300
    for mark in section.marks:
        assert np.hypot(*(places - (mark.x_mm, mark.y_mm)).T).min() > mark.diameter_mm
