from __future__ import annotations

import pytest
from pydantic import ValidationError

from vaoi_station.model import Fiducial
from vaoi_station.model.board_marks import fiducials_by_board, largest_distance


def mark(name: str, x: float, y: float, panel: str | int | None = None, **of: object) -> Fiducial:
    return Fiducial.model_validate({"name": name, "x": x, "y": y, "diameter": 1.0, "panel": panel} | of)


def test_fiducials_belong_to_their_board_unless_they_place_components() -> None:
    local = mark("L", 1, 1, "A", kind="local", components=["A/U1"])
    marks = [mark("P", 0, 0), mark("A1", 1, 0, "A"), local, mark("B1", 5, 0, 2), mark("A2", 4, 4, "A")]
    assert fiducials_by_board(marks) == {"A": (1, 4), "2": (3,)}


def test_the_largest_distance_is_that_of_two_fiducials() -> None:
    assert largest_distance([mark("a", 0, 0), mark("b", 3, 4), mark("c", 1, 1)]) == 5.0
    assert largest_distance([mark("a", 7, 7)]) == largest_distance([]) == 0.0


@pytest.mark.parametrize("panel", ["", "A/B", "x" * 41, "a\n"])
def test_a_position_that_addresses_cannot_contain_is_refused(panel: str) -> None:
    with pytest.raises(ValidationError):
        mark("a", 0, 0, panel)
