"""The CAD mapping of a board of the twin: turned, without an outline, or with fiducials that fit both ways."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from vaoi_station.model import BoardType, Status
from vaoi_station.stitching.expectation import Expectation


def described(board_type: BoardType, *, turned: bool = False, **keys: Any) -> BoardType:
    """Change keys of a board type, perhaps seen from its other end; None leaves a key out."""
    data = board_type.model_dump(mode="json", exclude_none=True)
    if turned:
        x, y = np.sum(data["outline"], axis=0).tolist()
        data["outline"] = [[x - a, y - b] for a, b in data["outline"]]
        for mark in data["fiducials"]:
            mark["x"], mark["y"] = x - mark["x"], y - mark["y"]
        for part in data["components"]:
            part["center"] = [x - part["center"][0], y - part["center"][1]]
    data |= keys
    return BoardType.model_validate({k: v for k, v in data.items() if v is not None})


def test_a_turned_board_is_found_if_expected_turned(filmed: Any) -> None:
    result = filmed.stitched(
        board_type=described(filmed.board_type, turned=True), expectation=Expectation(angle_rad=np.pi)
    )
    assert result.status is Status.OK
    assert filmed.error_px(result) < 0.2


@pytest.mark.parametrize("turned", [False, True])
def test_two_fiducials_alone_are_never_ok(filmed: Any, turned: bool) -> None:
    """Neither outline nor components: the board may lie either way."""
    marks = described(filmed.board_type, turned=turned).model_dump(mode="json")["fiducials"][:2]
    kind = described(filmed.board_type, turned=turned, outline=None, components=[], fiducials=marks)
    result = filmed.stitched(board_type=kind)
    assert result.status is Status.DEGRADED
    assert any("turned by 180°" in r for r in result.reasons)


def test_a_board_without_a_visible_edge_is_degraded(filmed: Any) -> None:
    """The outline is given 3 mm too large all round, as of another type."""
    (x0, y0), (x1, y1) = filmed.board_type.outline
    x0, x1, y0, y1 = min(x0, x1) - 3, max(x0, x1) + 3, min(y0, y1) - 3, max(y0, y1) + 3
    result = filmed.stitched(board_type=described(filmed.board_type, outline=[[x0, y0], [x1, y1]]))
    assert result.status is Status.DEGRADED
    assert any("no edge where the board's outline should be" in r for r in result.reasons)


def test_uncertainty_of_a_board_without_components_is_that_of_its_corners(filmed: Any) -> None:
    result = filmed.stitched(board_type=described(filmed.board_type, components=[]))
    assert result.status is Status.OK
    assert result.components == {}
    assert 0 < result.quality["cad_sigma_px"] < 0.2
