"""A wrong diameter of the fiducials in the board type is named, instead of their places."""

from __future__ import annotations

from typing import Any

import numpy as np
import pytest

from tests.stitching.quality.test_findings import findings_of
from vaoi_station.model import BoardType, Status
from vaoi_station.stitching.quality.agreement import wrong_size
from vaoi_station.stitching.quality.verdict import decide_verdict


def resized(board_type: BoardType, diameter: float) -> BoardType:
    marks = [mark.model_dump() | {"diameter": diameter} for mark in board_type.fiducials]
    return BoardType.model_validate(board_type.model_dump(mode="json", exclude_none=True) | {"fiducials": marks})


@pytest.mark.parametrize("stated", [0.7, 1.4, 2.0])
def test_marks_of_another_size_at_the_right_places_are_named(filmed: Any, stated: float) -> None:
    board_type = resized(filmed.board_type, stated)
    status, reasons = decide_verdict(findings_of(filmed, board_type=board_type))
    assert status is Status.FAILED
    assert reasons[0].code == "fiducial-size"
    assert f"are where fiducials of {stated:.2g} mm are expected: correct the diameter" in reasons[0].text
    found = float(reasons[0].text.split("marks of about ")[1].split(" mm")[0])
    assert found == pytest.approx(1.0, rel=0.1)
    assert "fiducials-not-found" in [code for code, _ in reasons]


def test_wrong_places_are_not_blamed_on_the_size(filmed: Any) -> None:
    marks = [mark.model_dump() for mark in filmed.board_type.fiducials]
    for n, mark in enumerate(marks):
        mark["x"] += 3.0 * n
    data = filmed.board_type.model_dump(mode="json", exclude_none=True) | {"fiducials": marks, "outline": None}
    found = findings_of(filmed, board_type=BoardType.model_validate(data))
    assert found.plane is not None
    texture = np.zeros((0, 2))
    assert wrong_size(found.plane.board_type, found.scene, found.expectation, found.moved.motion, texture) is None
