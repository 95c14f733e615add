"""Compare results with the truth."""

from __future__ import annotations

import math

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.demo.truth_comparison import compare_with_truth, true_speed_mm_s
from vaoi_station.simulation import Twin

TRUTH = {"U1": [[0, 0, 10.0, 20.0], [1, 0, 30.0, 40.0]], "R1": [[0, 2, 5.0, 6.0]]}
SHIFT = st.floats(-5, 5)


def test_truth_has_no_distance_from_itself() -> None:
    same = compare_with_truth(TRUTH, TRUTH, [10.0, 20.0])
    assert (same.views, same.unplaced, same.rms_px, same.max_px, same.max_mm) == (3, 0, 0.0, 0.0, 0.0)


@given(SHIFT, SHIFT)
def test_shift_is_measured_in_px_and_in_mm_of_each_camera(dx: float, dy: float) -> None:
    found = {"U1": [[0, 0, 10.0, 20.0], [1, 0, 30.0 + dx, 40.0 + dy]], "R1": TRUTH["R1"]}
    off = compare_with_truth(TRUTH, found, [10.0, 20.0])
    length = math.hypot(dx, dy)
    assert off.max_px == pytest.approx(length, abs=1e-5)
    assert off.rms_px == pytest.approx(length / math.sqrt(3), abs=1e-5)
    assert off.max_mm == pytest.approx(length / 20, abs=1e-5)
    assert length < 1e-5 or off.worst == "U1, camera 1, row 0"


def test_views_missing_in_the_result_are_counted_and_additional_ones_are_ignored() -> None:
    found = {"U1": [[0, 0, 10.0, 20.0], [0, 5, 99.0, 99.0]], "U7": [[0, 0, 1.0, 1.0]]}
    off = compare_with_truth(TRUTH, found, [10.0, 20.0])
    assert (off.views, off.unplaced, off.max_px) == (1, 2, 0.0)


def test_run_without_positions_has_no_compared_views() -> None:
    off = compare_with_truth(TRUTH, {}, [10.0, 20.0])
    assert (off.views, off.unplaced, off.rms_px, off.worst) == (0, 3, 0.0, None)


def test_true_speed_is_near_that_of_the_scenario(twin: Twin) -> None:
    speeds = [true_speed_mm_s(twin.passage(board)) for board in range(4)]
    assert all(abs(speed - 100) < 3 for speed in speeds)
    assert len(set(speeds)) == 4, "the speed differs from board to board"
