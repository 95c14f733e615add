from __future__ import annotations

import math
from dataclasses import replace

import numpy as np
import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.simulation.motion.belt import Belt, board_motion, waves
from vaoi_station.simulation.scenario import BeltSection

TIMES = st.floats(0, 1000)


@given(TIMES)
def test_way_is_the_integral_of_the_speed(t: float) -> None:
    belt = Belt(BeltSection(speed_wander=0.05, speed_error=0.01))
    step = 1e-4
    slope = (belt.travelled_mm(t + step) - belt.travelled_mm(t - step)) / (2 * step)
    assert math.isclose(slope, belt.speed_mm_s(t), rel_tol=1e-6)


def test_waves_have_unit_rms() -> None:
    wave = waves(3, 0, 0.8)
    values = [wave.value(t) for t in np.linspace(0, 400, 20001)]
    assert abs(float(np.std(values)) - 1) < 0.03


@given(TIMES, st.integers(0, 50))
def test_poses_are_rigid_and_carry_the_middle(t: float, board: int) -> None:
    way = board_motion(BeltSection(), board, start_s=5.0 * board, start_along_mm=-60, across_mm=30, turned_deg=90)
    pose = way.pose(t, (40.0, 25.0))
    assert np.allclose(pose[:2, :2] @ pose[:2, :2].T, np.eye(2), atol=1e-12)
    assert np.allclose((pose @ [40, 25, 1])[:2], way.center(t)[:2], atol=1e-9)


def test_turned_boards_turn_counter_clockwise_as_seen() -> None:
    section = BeltSection(yaw_sigma_deg=0, yaw_wander_deg=0, offset_sigma_mm=0, sway_mm=0)
    way = board_motion(section, 0, start_s=0, start_along_mm=0, across_mm=0, turned_deg=90)
    pose = way.pose(0.0, (0.0, 0.0))
    # the board's x axis, to the right, then points up: tester y runs down in the picture
    assert np.allclose(pose[:2, 0], [0, -1], atol=1e-12)


@given(TIMES)
def test_texture_of_the_belt_moves_by_its_share_of_the_board(t: float) -> None:
    way = board_motion(BeltSection(), 3, start_s=0.0, start_along_mm=-60, across_mm=30, turned_deg=0)
    assert np.array_equal(way.belt_pose(t, 0.0), way.belt_pose(0.0, 1.0))
    with_board = way.belt_pose(t, 1.0) @ np.linalg.inv(way.belt_pose(0.0, 1.0))
    assert np.allclose(with_board, way.pose(t, (40.0, 25.0)) @ np.linalg.inv(way.pose(0.0, (40.0, 25.0))), atol=1e-7)
    half = way.belt_pose(t, 0.5)[:2, 2] - way.belt_pose(0.0, 0.5)[:2, 2]
    assert np.allclose(2 * half, np.array(way.center(t)[:2]) - way.center(0.0)[:2], atol=1e-7)


def test_a_board_that_sticks_does_not_stop_the_belt() -> None:
    way = replace(board_motion(BeltSection(), 0, start_s=0, start_along_mm=0, across_mm=0, turned_deg=0), stop_s=1.0)
    assert np.array_equal(way.pose(3.0, (4.0, 2.0)), way.pose(1.0, (4.0, 2.0)))
    assert not np.allclose(way.belt_pose(3.0, 1.0), way.belt_pose(1.0, 1.0))


def test_boards_differ_and_repeat() -> None:
    section = BeltSection()
    ways = [board_motion(section, k, start_s=0, start_along_mm=0, across_mm=0, turned_deg=0) for k in (0, 1, 0)]
    assert ways[0] == ways[2]
    assert ways[0].yaw_rad != ways[1].yaw_rad


def test_a_stuck_board_stays_where_it_stopped() -> None:
    section = BeltSection(yaw_rate_deg_s=2.0)
    moving = board_motion(section, 1, start_s=5.0, start_along_mm=-40, across_mm=0, turned_deg=0)
    stuck = replace(moving, stop_s=0.4)
    assert stuck.pose(0.3, (0.0, 0.0)).tolist() == moving.pose(0.3, (0.0, 0.0)).tolist()
    assert stuck.pose(9.0, (0.0, 0.0)).tolist() == moving.pose(0.4, (0.0, 0.0)).tolist()


@given(TIMES)
def test_without_variation_the_belt_is_uniform(t: float) -> None:
    belt = Belt(BeltSection(speed_mm_s=80.0, speed_error=0.05, speed_wander=0, sway_mm=0, yaw_wander_deg=0))
    assert belt.travelled_mm(t) == pytest.approx(84.0 * t)
    assert belt.speed_mm_s(t) == pytest.approx(84.0)
    assert (belt.sway_mm(t), belt.yaw_rad(t)) == (0.0, 0.0)


@pytest.mark.parametrize("direction", [1, -1])
def test_the_direction_decides_the_sign_of_the_motion(direction: int) -> None:
    section = BeltSection.model_validate({"direction": direction, "offset_sigma_mm": 0.0, "sway_mm": 0.0})
    motion = board_motion(section, 0, start_s=0, start_along_mm=-50, across_mm=7, turned_deg=0)
    (x0, y0, _), (x1, y1, _) = motion.center(0.0), motion.center(1.0)
    assert y0 == -50 * direction
    assert (y1 - y0) * direction == pytest.approx(100, rel=0.05)
    assert [x0, x1] == pytest.approx([7, 7])


def test_a_skewed_belt_moves_boards_sideways() -> None:
    section = BeltSection(skew_deg=10.0, speed_wander=0, sway_mm=0, offset_sigma_mm=0)
    motion = board_motion(section, 0, start_s=0, start_along_mm=0, across_mm=0, turned_deg=0)
    x, y, _ = motion.center(1.0)
    angle = math.radians(10)
    assert [x, y] == pytest.approx([100 * math.sin(angle), 100 * math.cos(angle)])


@given(st.integers(0, 9), st.integers(0, 3), st.floats(0.1, 5.0))
def test_the_integral_of_a_wave_is_bounded(seed: int, purpose: int, period_s: float) -> None:
    """Its mean is 0, so the belt does not drift away from its uniform motion."""
    wave = waves(seed, purpose, period_s)
    bound = 2 * wave.amplitude * sum(1 / w for w in wave.omega)
    assert wave.integral(0.0) == 0.0
    assert all(abs(wave.integral(t)) <= bound for t in np.linspace(0, 100 * period_s, 50))


def test_offsets_scatter_from_board_to_board_as_stated() -> None:
    section = BeltSection(offset_mm=2.0, offset_sigma_mm=0.5, yaw_sigma_deg=0.4)
    motions = [board_motion(section, k, start_s=0, start_along_mm=0, across_mm=1, turned_deg=0) for k in range(400)]
    across = [motion.across_mm for motion in motions]
    assert np.mean(across) == pytest.approx(3.0, abs=0.1)
    assert np.std(across) == pytest.approx(0.5, rel=0.1)
    assert np.std([math.degrees(motion.yaw_rad) for motion in motions]) == pytest.approx(0.4, rel=0.1)
