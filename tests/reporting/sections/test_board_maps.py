"""Maps of the board: orientation, cells inside the outline, grey components without a value."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.model import BoardType
from vaoi_station.reporting import StitchedRun
from vaoi_station.reporting.sections.board_maps import BoardDrawing, components, surface


@pytest.mark.parametrize("y_axis", ["up", "down"])
def test_cad_up_is_drawn_upwards(y_axis: str) -> None:
    plan = BoardDrawing(BoardType.model_validate({"name": "b", "outline": [[0, 0], [40, 20]], "y_axis": y_axis}))
    at = plan.at(np.array([[0.0, 0.0], [40.0, 20.0]]))
    assert at[0, 0] < at[1, 0]
    assert (at[0, 1] > at[1, 1]) == (y_axis == "up")
    assert (at >= 0).all()
    assert (at <= (plan.width, plan.height)).all()


def test_cells_lie_inside_the_outline() -> None:
    triangle = BoardType.model_validate({"name": "t", "outline": [[0, 0], [30, 0], [0, 30]]})
    centres, side = BoardDrawing(triangle).cells()
    assert (centres.sum(1) <= 30 + 1e-9).all()
    assert len(centres) * side**2 == pytest.approx(450, rel=0.1)


def test_components_and_surface_are_drawn(stitched: StitchedRun) -> None:
    board_type, q = stitched.opened.setup.board_type, stitched.result.quality
    assert board_type is not None
    html = components(stitched).html()
    unknown = len(board_type.components) - len(q["heights_mm"])
    assert unknown > 0
    assert html.count('fill="#dfe3e6"') == unknown + len(board_type.components) - len(q["component_sigma_px"])
    found = stitched.result.surface
    assert found is not None
    assert "bow" in surface(stitched).html()
    flat = StitchedRun(
        stitched.opened, (), stitched.result.model_copy(update={"surface": None}), stitched.findings, {}, {}
    )
    assert "Not estimated" in surface(flat).html()
