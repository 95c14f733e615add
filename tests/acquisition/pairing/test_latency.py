"""Tests of learning a camera's latency from the beginning of a run."""

from __future__ import annotations

from dataclasses import replace

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.pairing.evidence import GATE_S
from vaoi_station.acquisition.pairing.latency import Beginning, CameraLatency, LatencySettings, in_order_s, learn

T = 0.03
PULSES_S = [10.0 + k * T for k in range(5)]
BOUND_S = 1e-4


def beginning(latency_s: float, rows: list[int], *, pulses: int = 5, silent: bool = True) -> Beginning:
    frames_s = [PULSES_S[0] + row * T + latency_s for row in rows]
    return Beginning(PULSES_S[:pulses], frames_s, T, BOUND_S, silent)


def learnt(begun: Beginning, expected_s: float = 0.0) -> tuple[object, bool]:
    found = learn(begun, expected_s, GATE_S)
    assert found is not None
    return found.latency_s, found.confirmed


def test_a_frame_at_the_first_pulse_confirms_a_latency_near_zero_at_once() -> None:
    assert learnt(beginning(2e-5, [0], pulses=1), 0.0) == (pytest.approx(2e-5, abs=1e-9), True)


@pytest.mark.parametrize("latency_ms", [12, 20, 28])
def test_three_frames_of_the_first_pulses_confirm_any_latency_below_the_period(latency_ms: float) -> None:
    assert learn(beginning(latency_ms / 1e3, [0, 1]), 0.0, GATE_S) is None
    assert learnt(beginning(latency_ms / 1e3, [0, 1, 2]), 0.0) == (pytest.approx(latency_ms / 1e3), True)


@pytest.mark.parametrize("latency_ms", [29.95, 30, 33, 58])
def test_beyond_the_period_the_count_of_frames_decides_at_the_end(latency_ms: float) -> None:
    early = beginning(latency_ms / 1e3, [0, 1, 2, 3])
    assert learn(early, 0.0, GATE_S) is None
    assert learnt(replace(beginning(latency_ms / 1e3, [0, 1, 2, 3, 4]), all_fired=True), 0.0) == (
        pytest.approx(latency_ms / 1e3),
        True,
    )


def test_a_single_frame_far_from_the_expected_latency_confirms_nothing() -> None:
    """It may be an extra exposure whose frame arrived before that of the pulse."""
    single = replace(Beginning(PULSES_S[:1], [10.02], T, BOUND_S, True), all_fired=True)
    assert learn(single, 0.0, GATE_S) is None
    assert learnt(replace(single, overdue=True), 0.0) == (pytest.approx(0.02), False)
    assert learnt(single, 0.02) == (pytest.approx(0.02), True)


def test_without_the_first_frame_the_shortest_latency_is_assumed_and_not_confirmed() -> None:
    """The frames of rows 1, 2, … at 28 ms could be those of rows 0, 1, … at 58 ms."""
    early = beginning(0.028, [1, 2, 3, 4])
    assert learn(early, 0.0, GATE_S) is None
    assert learnt(replace(early, overdue=True), 0.0) == (pytest.approx(0.028), False)


def test_an_expected_latency_beyond_the_period_stays_if_the_frames_fit_it() -> None:
    assert learnt(replace(beginning(0.058, [1, 2, 3]), overdue=True), 0.058) == (pytest.approx(0.058), False)


def test_frames_before_the_first_pulse_leave_the_latency_open() -> None:
    """A camera that was not silent may run freely."""
    busy = beginning(0.0, [0, 1, 2], silent=False)
    assert learn(busy, 0.0, GATE_S) is None
    assert learnt(replace(busy, overdue=True), 0.0) == (pytest.approx(0.0, abs=1e-9), False)


def test_several_frames_for_one_pulse_show_no_latency() -> None:
    free = Beginning(PULSES_S, [10.015, 10.025, 10.035, 10.045], T, BOUND_S, True)
    assert learnt(free, 0.0) == (0.0, False)


def test_jitter_at_the_edge_of_the_error_bound_is_not_several_frames_for_one_pulse() -> None:
    """With clocks read on a busy computer the bound reaches the rest of the period; one frame came for every pulse."""
    rest_s = 0.002
    frames_s = [p + T - rest_s + e for p, e in zip(PULSES_S[:3], (0.0, 5e-6, -5e-6), strict=True)]
    begun = Beginning(PULSES_S[:4], frames_s, T, rest_s, True)
    assert learn(begun, 0.0, GATE_S) is None
    complete = replace(begun, pulses_s=PULSES_S[:3], all_fired=True)
    assert learnt(complete) == (pytest.approx(T - rest_s), True)


@given(st.floats(0, 2.5 * T), st.integers(1, 5))
def test_frames_in_order_give_their_latency(latency_s: float, count: int) -> None:
    frames_s = [p + latency_s for p in PULSES_S[:count]]
    assert in_order_s(PULSES_S[:count], frames_s, BOUND_S, GATE_S) == pytest.approx(latency_s, abs=1e-9)
    assert in_order_s(PULSES_S[:count], frames_s[1:], BOUND_S, GATE_S) is None


def test_time_stamps_before_their_pulses_are_no_latency() -> None:
    assert in_order_s(PULSES_S, [p - 0.002 for p in PULSES_S], BOUND_S, GATE_S) is None


def test_a_given_latency_is_never_changed() -> None:
    latency = CameraLatency(LatencySettings(given_s=0.028))
    latency.revise(0.001, 0.05, assigned=0, extra=5)
    assert (latency.value_s, latency.confirmed) == (0.028, True)


def test_a_learnt_latency_follows_the_frames_and_is_learnt_again_after_a_jump() -> None:
    latency = CameraLatency(LatencySettings())
    latency.learn(beginning(0.0, [0]))
    latency.revise(0.001, None, assigned=5, extra=0)
    assert (latency.value_s, latency.confirmed) == (0.001, True)
    latency.revise(None, 0.028, assigned=4, extra=1)
    assert (latency.value_s, latency.confirmed) == (0.028, False)
    latency.learn(beginning(0.028, [0]))
    assert latency.confirmed
    latency.revise(None, None, assigned=0, extra=3)
    assert latency.value_s == pytest.approx(0.028)
    assert not latency.confirmed
