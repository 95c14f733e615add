"""Moves of board data."""

from __future__ import annotations

import math

import numpy as np
import pytest

from tests.board_check.conftest import ALL, drawn_board
from vaoi_station.board_check.correction import Move, moved_board_type
from vaoi_station.geometry import apply
from vaoi_station.model import BoardType


def test_what_is_within_the_noise_is_no_part_of_a_correction() -> None:
    move = Move(False, 90.02, 1.0004, (0.0, 0.0), (1.0, 0.0))
    assert move.snapped(0.01, 0.0002) == Move(False, 90.0, 1.0, (0.0, 0.0), (1.0, 0.0))
    assert move.snapped(0.001, 0.0001) == move


@pytest.mark.parametrize("y_axis", ["up", "down"])
def test_footprints_and_test_points_move_with_the_centres_in_every_unit(y_axis: str) -> None:
    parts = [{"ref": "U1", "center": [1, 0.5], "origin": [1, 0.4], "width": 0.2, "height": 0.1, "rotation": 30}]
    points = {"name": ["U1-1"], "x": [1], "y": [0.4]}
    board = BoardType.model_validate(
        {"name": "b", "unit": "inch", "y_axis": y_axis, "components": parts, "test_points": points}
    )
    up = np.diag([25.4, 25.4 if y_axis == "up" else -25.4, 1.0])
    for mirrored in (False, True):
        move = Move(mirrored, 25.0, 1.0, (0.0, 0.0), (3.0, 1.0))
        moved = moved_board_type(board, move, ALL)
        there = apply(move.matrix @ up, board.footprint(board.components[0]))
        corners = apply(up, moved.footprint(moved.components[0]))
        # Mirrored corners come in another order.
        assert all(min(math.dist(a, b) for b in corners) < 1e-3 for a in there)
        assert moved.components[0].origin == pytest.approx(
            tuple(apply(np.linalg.inv(up) @ move.matrix @ up, np.array([1, 0.4]))), abs=1e-5
        )
        assert moved.test_points is not None
        assert (moved.test_points.x[0], moved.test_points.y[0]) == moved.components[0].origin


def test_an_outline_that_loses_its_fiducials_is_refused() -> None:
    with pytest.raises(ValueError, match="outside the outline"):
        moved_board_type(drawn_board(), Move(False, 0.0, 1.0, (0.0, 0.0), (40.0, 0.0)), ("components", "fiducials"))


@pytest.mark.parametrize("degrees", [90.0, 0.0, 30.0])
def test_places_of_codes_and_marks_of_the_fixture_move_with_the_fiducials(degrees: float) -> None:
    board = BoardType.model_validate(
        {
            "name": "b",
            "unit": "mm",
            "outline": [[0, 0], [10, 10]],
            "identity": {"pattern": "demo;{id}", "places": [{"center": [4, 2], "width": 3, "height": 1}]},
            "fixture_mark": {"shape": "cross", "size": 2, "width": 0.5, "polarity": "light"},
            "fixture_marks": [{"x": -3, "y": 5}],
        }
    )
    move = Move(False, degrees, 1.0, (0.0, 0.0), (1.0, 2.0))
    moved = moved_board_type(board, move, ALL)
    assert moved.identity is not None
    [place], [mark] = moved.identity.places, moved.fixture_marks
    assert place.center == pytest.approx(tuple(apply(move.matrix, np.array([4.0, 2.0]))), abs=1e-4)
    assert (mark.x, mark.y) == pytest.approx(tuple(apply(move.matrix, np.array([-3.0, 5.0]))), abs=1e-4)
    corners = np.array([(2.5, 1.5), (5.5, 1.5), (5.5, 2.5), (2.5, 2.5)])
    assert (place.width, place.height) == pytest.approx(tuple(np.ptp(apply(move.matrix, corners), axis=0)), abs=1e-4)
    assert moved.identity.pattern == "demo;{id}"
    assert moved_board_type(board, move, ("components",)).identity == board.identity
