"""Heights of bodies: measured before nominal, and a sentence where there is none."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.model import BoardType, Status, Stitch
from vaoi_station.rendering.body_height import BodyHeight, body_height, plane_remark


def given(height: float | None, quality: dict[str, Any], unit: str = "mm") -> BodyHeight | None:
    part = {"ref": "U1", "center": [1, 1], "width": 1, "height": 1, "body_height": height}
    board_type = BoardType.model_validate({"name": "b", "unit": unit, "components": [part]})
    stitch = Stitch(
        method="m", image_matrices=(), cad_matrix=np.eye(3), row_motion=(), status=Status.OK, quality=quality
    )
    return body_height(board_type.components[0], board_type, stitch)


def test_a_measured_height_comes_first() -> None:
    quality = {"heights_mm": {"U1": 1.21}, "height_sigma_mm": {"U1": 0.02}}
    assert given(1.0, quality) == BodyHeight(1.21, 0.02, "measured")
    assert given(None, {"heights_mm": {"U1": 1.21}}) == BodyHeight(1.21, None, "measured")


def test_else_that_of_the_board_type_in_mm() -> None:
    nominal = given(1000.0, {}, "mil")
    assert nominal is not None
    assert (nominal.sigma_mm, nominal.source) == (None, "board-type")
    assert nominal.mm == pytest.approx(25.4)


@pytest.mark.parametrize("figures", [{}, {"U1": None}, {"U1": True}, {"U1": float("nan")}, [1]])
def test_without_either_there_is_none_and_the_remark_says_so(figures: Any) -> None:
    assert given(None, {"heights_mm": figures}) is None
    part = BoardType.model_validate(
        {"name": "b", "components": [{"ref": "U1", "center": [1, 1], "width": 1, "height": 1}]}
    )
    assert "U1 has no height: the run measured none" in (plane_remark(part.components[0], None, True) or "")
    assert "no working_distance_mm" in (plane_remark(part.components[0], BodyHeight(1, None, "measured"), False) or "")
    assert plane_remark(part.components[0], BodyHeight(1, None, "measured"), True) is None
