from __future__ import annotations

import math

import numpy as np
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


def test_boards_differ_and_repeat() -> None:
    section = BeltSection()
    ways = [board_motion(section, k, start_s=0, start_along_mm=0, across_mm=0, turned_deg=0) for k in (0, 1, 0)]
    assert ways[0] == ways[2]
    assert ways[0].yaw_rad != ways[1].yaw_rad
