"""Shift and turn of a few fiducials, from known motions."""

from __future__ import annotations

import numpy as np
import pytest

from vaoi_station.geometry import apply
from vaoi_station.stitching.components.places import fit_shift_and_turn

AT = np.array([[10.0, 20.0], [40.0, 24.0], [30.0, 60.0]])


@pytest.mark.parametrize("turn_deg", [0.0, 0.1, -0.5])
@pytest.mark.parametrize("count", [2, 3])
def test_a_rigid_motion_is_found(count: int, turn_deg: float) -> None:
    a, at = np.radians(turn_deg), AT[:count]
    motion = np.array([[np.cos(a), -np.sin(a), 0.3], [np.sin(a), np.cos(a), -0.2], [0, 0, 1]])
    found = fit_shift_and_turn(at, apply(motion, at) - at)
    assert found.turn_rad == pytest.approx(a, abs=1.2e-7)
    assert apply(found.matrix, at) == pytest.approx(apply(motion, at), abs=1e-5)
    assert found.middle_mm == pytest.approx(at.mean(0))
    assert found.spread_mm2 == pytest.approx(((at - at.mean(0)) ** 2).sum())


def test_what_a_rigid_motion_does_not_explain_shifts_and_turns_nothing() -> None:
    """Two fiducials that lie farther apart: a stretch about their middle."""
    found = fit_shift_and_turn(AT[:2], 0.01 * (AT[:2] - AT[:2].mean(0)))
    assert found.matrix == pytest.approx(np.eye(3), abs=1e-12)


def test_one_fiducial_shows_a_shift_only() -> None:
    found = fit_shift_and_turn(AT[:1], np.array([[0.2, -0.1]]))
    assert found.turn_rad == 0.0
    assert found.matrix == pytest.approx(np.array([[1, 0, 0.2], [0, 1, -0.1], [0, 0, 1]]))
