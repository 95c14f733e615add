"""Tests of the comparison of time stamps with pulses."""

from __future__ import annotations

import statistics

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.pairing.evidence import MAX_DRIFT, free_running_interval_s, median, residuals_s

finite = st.floats(-1e6, 1e6)


@given(st.lists(finite, min_size=1, max_size=50))
def test_the_median_is_that_of_the_standard_library(values: list[float]) -> None:
    assert median(values) == pytest.approx(statistics.median(values))


@given(st.integers(2, 40), st.floats(-1e5, 1e5), st.floats(-0.9 * MAX_DRIFT, 0.9 * MAX_DRIFT), st.floats(0.01, 1.0))
def test_offset_and_drift_leave_no_residuals(rows: int, offset_s: float, drift: float, period_s: float) -> None:
    pulses = [7.0 + row * period_s for row in range(rows)]
    assert abs(residuals_s(pulses, [offset_s + (1 + drift) * p for p in pulses])).max() < 1e-7


@given(st.data())
def test_a_fifth_of_outliers_is_found_and_does_not_move_the_line(data: st.DataObject) -> None:
    rows = data.draw(st.integers(10, 40))
    outliers = data.draw(st.sets(st.integers(0, rows - 1), max_size=rows // 5))
    drift, jitter_s = data.draw(st.floats(-2e-4, 2e-4)), 5e-6
    pulses = [row * 0.12 for row in range(rows)]
    late_s = [data.draw(st.floats(0.001, 0.01)) if n in outliers else 0.0 for n in range(rows)]
    camera = [p * (1 + drift) + data.draw(st.floats(0, jitter_s)) + s for p, s in zip(pulses, late_s, strict=True)]
    off = abs(residuals_s(pulses, camera))
    assert {n for n in range(rows) if off[n] > 200e-6} == outliers
    assert all(off[n] < 100e-6 for n in range(rows) if n not in outliers)


def test_fewer_than_two_frames_have_zero_residuals() -> None:
    assert residuals_s([1.0], [5.0]).tolist() == [0.0]
    assert residuals_s([], []).tolist() == []


def test_the_drift_is_limited_to_that_of_real_crystals() -> None:
    assert abs(residuals_s([0.0, 0.1], [0.0, 0.104])).max() > 1e-3


def test_a_free_running_camera_is_recognised_across_losses_and_the_wrap() -> None:
    assert free_running_interval_s([0.0, 0.033, 0.099], [65534, 65535, 2]) == pytest.approx(0.033)
    assert free_running_interval_s([0.0, 0.033, 0.08], [1, 2, 3]) is None
    assert free_running_interval_s([0.0, 0.033, 0.066], [1, 2, 2]) is None
    assert free_running_interval_s([0.0, 0.033], [1, 2]) is None
