"""The motion of boards: rigid, repeatable, and as the scenario states it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.simulation.motion.belt import BoardMotion
from vaoi_station.simulation.scenario import BeltSection

TIMES = st.floats(0, 1000)
STEADY = BeltSection(speed_wander=0, sway_mm=0, offset_sigma_mm=0, yaw_sigma_deg=0, yaw_wander_deg=0)


def motion(belt: BeltSection, board: int = 0, *, start_s: float = 0.0, turned_deg: int = 0) -> BoardMotion:
    return BoardMotion.of(belt, board, start_s, 0.0, turned_deg, 0.0)


@given(TIMES, st.integers(0, 50))
def test_poses_are_rigid_and_carry_the_middle(t: float, board: int) -> None:
    way = motion(BeltSection(), board, start_s=5.0 * board, turned_deg=90)
    pose = way.pose(t, (40.0, 25.0))
    assert np.allclose(pose[:2, :2] @ pose[:2, :2].T, np.eye(2), atol=1e-12)
    assert np.allclose((pose @ [40, 25, 1])[:2], way.center(t)[:2], atol=1e-9)


def test_a_board_that_sticks_stays_while_the_belt_moves_on() -> None:
    moving = motion(BeltSection(yaw_rate_deg_s=2.0), 1, start_s=5.0)
    stuck = replace(moving, stop_s=1.0)
    assert np.array_equal(stuck.pose(0.3, (4.0, 2.0)), moving.pose(0.3, (4.0, 2.0)))
    assert np.array_equal(stuck.pose(3.0, (4.0, 2.0)), moving.pose(1.0, (4.0, 2.0)))
    assert not np.allclose(stuck.belt_pose(3.0, 1.0), stuck.belt_pose(1.0, 1.0))


@pytest.mark.parametrize("direction", [1, -1])
def test_a_belt_moves_with_its_speed_direction_and_skew(direction: int) -> None:
    changed = {"speed_mm_s": 80.0, "speed_error": 0.05, "skew_deg": 10.0, "direction": direction}
    x, y, turned = motion(STEADY.model_copy(update=changed)).center(2.0)
    angle = math.radians(10)
    assert [x, y, turned] == pytest.approx([168 * math.sin(angle), direction * 168 * math.cos(angle), 0.0])
