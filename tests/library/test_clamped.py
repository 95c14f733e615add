"""A board that the twin filmed in one pose, and a tester clamps in another."""

from __future__ import annotations

import numpy as np
import pytest

import vaoi_station as vaoi


def test_points_of_a_filmed_board_are_where_they_are_stated(stitched: vaoi.StitchedRun) -> None:
    board, random = stitched.board_type, np.random.default_rng(11)
    assert board is not None
    marks, parts = (np.array(p) for p in ([(f.x, f.y) for f in board.fiducials], [c.center for c in board.components]))
    turn = np.array([[np.cos(2.0), -np.sin(2.0)], [np.sin(2.0), np.cos(2.0)]])
    errors, low, high = [], *board.extent()
    for _ in range(60):
        # A bow of 0.2 mm moves the surface by half the thickness times its slope.
        bow = random.normal(0, 0.2, 2) / ((high - low) / 2) ** 2
        at_marks, at_parts = (
            (p - 1.6 * bow * (p - (low + high) / 2)) @ turn.T + (300.0, -40.0) for p in (marks, parts)
        )
        read = at_marks + random.normal(0, 0.01, marks.shape)
        readings = {f.name: (x, y) for f, (x, y) in zip(board.fiducials, read.tolist(), strict=True)}
        answer = stitched.clamped(readings, sigma=0.01, turn_deg=float(np.degrees(2.0)), points=stitched.refs)
        placed = np.array([(p.x, p.y, p.sigma_x, p.sigma_y) for p in answer.points])
        errors.append((placed[:, :2] - at_parts) / placed[:, 2:])
    assert 0.7 < np.sqrt(np.mean(np.square(errors))) < 1.4


def test_wrong_arguments_name_the_field(stitched: vaoi.StitchedRun) -> None:
    with pytest.raises(vaoi.InputError, match="sigma"):
        stitched.clamped({"FID1": (0.0, 0.0)})
    with pytest.raises(vaoi.InputError, match="FID9"):
        stitched.clamped({"FID9": (0.0, 0.0)}, sigma=0.01)
