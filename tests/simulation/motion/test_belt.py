"""The motion of boards: rigid, repeatable, and as the scenario states it."""

from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.simulation.motion.belt import BoardMotion, waves
from vaoi_station.simulation.scenario import BeltSection

TIMES = st.floats(0, 1000)
STEADY = BeltSection(speed_wander=0, sway_mm=0, offset_sigma_mm=0, yaw_sigma_deg=0, yaw_wander_deg=0)


def motion(belt: BeltSection, board: int = 0, *, start_s: float = 0.0, turned_deg: int = 0) -> BoardMotion:
    return BoardMotion.of(belt, board, start_s, 0.0, turned_deg, 0.0)


def test_waves_have_unit_rms_and_the_integral_of_their_values() -> None:
    wave, times = waves(3, 0, 0.8), np.linspace(0, 400, 20001)
    values = [wave.value(t) for t in times]
    assert abs(float(np.std(values)) - 1) < 0.03
    assert wave.integral(400.0) == pytest.approx(float(np.trapezoid(values, times)), abs=1e-3)


@given(TIMES, st.integers(0, 50))
def test_poses_are_rigid_and_carry_the_middle(t: float, board: int) -> None:
    way = motion(BeltSection(), board, start_s=5.0 * board, turned_deg=90)
    pose = way.pose(t, (40.0, 25.0))
    assert np.allclose(pose[:2, :2] @ pose[:2, :2].T, np.eye(2), atol=1e-12)
    assert np.allclose((pose @ [40, 25, 1])[:2], way.center(t)[:2], atol=1e-9)


def test_turned_boards_turn_counter_clockwise_as_seen() -> None:
    # The board's x axis, to the right, then points up: tester y runs down in the picture.
    assert np.allclose(motion(STEADY, turned_deg=90).pose(0.0, (0.0, 0.0))[:2, 0], [0, -1], atol=1e-12)


@given(TIMES)
def test_texture_of_the_belt_moves_by_its_share_of_the_board(t: float) -> None:
    way = motion(BeltSection(), 3)
    assert np.array_equal(way.belt_pose(t, 0.0), way.belt_pose(0.0, 1.0))
    with_board = way.belt_pose(t, 1.0) @ np.linalg.inv(way.belt_pose(0.0, 1.0))
    assert np.allclose(with_board, way.pose(t, (40.0, 25.0)) @ np.linalg.inv(way.pose(0.0, (40.0, 25.0))), atol=1e-7)
    half = way.belt_pose(t, 0.5)[:2, 2] - way.belt_pose(0.0, 0.5)[:2, 2]
    assert np.allclose(2 * half, np.array(way.center(t)[:2]) - way.center(0.0)[:2], atol=1e-7)


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


def test_boards_repeat_and_scatter_as_stated() -> None:
    section = BeltSection(offset_mm=2.0, offset_sigma_mm=0.5, yaw_sigma_deg=0.4)
    motions = [motion(section, k) for k in range(400)]
    assert motions[7] == motion(section, 7)
    across = [m.across_mm for m in motions]
    assert np.mean(across) == pytest.approx(2.0, abs=0.1)
    assert np.std(across) == pytest.approx(0.5, rel=0.1)
    assert np.std([math.degrees(m.yaw_rad) for m in motions]) == pytest.approx(0.4, rel=0.1)
