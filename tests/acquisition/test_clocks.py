"""Clock models and the clocks of simulated devices."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.clocks import ClockModel, ClockReading, DeviceClock, apart_s

readings = st.lists(st.tuples(st.floats(0, 100), st.floats(1e-6, 0.05), st.floats(-1, 1)), min_size=1, max_size=40).map(
    sorted
)


@given(readings, st.floats(-1e6, 1e6), st.floats(-100, 100), st.floats(0, 200))
def test_the_bound_holds(
    taken: list[tuple[float, float, float]], offset_s: float, drift_ppm: float, asked_s: float
) -> None:
    true = DeviceClock(offset_s, drift_ppm, origin_s=5000.0)
    model = ClockModel("camera")
    for at_s, bound_s, error in taken:
        host_s = 5000.0 + at_s
        model.add(ClockReading(true.device_s(host_s), host_s + error * bound_s, bound_s))
    assert model.restarts == 0
    device_s = true.device_s(5000.0 + asked_s)
    assert abs(model.host_s(device_s) - (5000.0 + asked_s)) <= model.bound_s(device_s) + 1e-9
    assert model.device_s(model.host_s(device_s)) == pytest.approx(device_s, abs=1e-6)


def test_a_jump_of_the_clock_starts_a_new_line() -> None:
    model = ClockModel("controller")
    for k in range(10):
        model.add(ClockReading(float(k), 100.0 + k, 1e-4))
    jump = model.add(ClockReading(0.5, 110.0, 1e-4))
    assert model.restarts == 1
    assert jump is not None
    assert round(jump.size_s, 6) == -9.5
    assert (jump.since_s, jump.until_s) == pytest.approx((109.0 - 1e-4, 110.0 + 1e-4), abs=1e-9)
    assert str(jump) == "its clock jumped by -9.50 s"
    assert model.host_s(1.5) == pytest.approx(111.0, abs=1e-3)


def test_a_step_within_the_errors_of_readings_is_no_jump() -> None:
    model = ClockModel("camera c0")
    for k in range(10):
        assert model.add(ClockReading(float(k), 100.0 + k, 1e-5)) is None
    assert model.add(ClockReading(10.0005, 110.0, 1e-5)) is None
    assert model.restarts == 1, "the line begins anew nevertheless"


@given(st.lists(st.floats(-1, 1), min_size=3, max_size=12), st.floats(-5.1e-3, 5.1e-3))
def test_clocks_of_one_time_are_apart_when_they_certainly_are(errors: list[float], off_s: float) -> None:
    """All but the first show the time of one master, read with errors up to the bounds, from zeros of their own."""
    clocks = {}
    for k, error in enumerate(errors):
        epoch_ns = 1_700_000_000_000_000_000 + 1_000_000_007 * k
        clocks[k] = ClockModel("camera"), epoch_ns
        for at_s in range(5):
            shown_s = at_s - 1.000000007 * k + (off_s if k == 0 else 0)
            clocks[k][0].add(ClockReading(shown_s, at_s + error * 1e-3, 1e-3))
    apart = apart_s({**clocks, len(errors): (ClockModel("never read"), 0)}, 4.0)
    assert all(apart[k] == 0 for k in apart if k > 0 or abs(off_s) < 1e-4)
    if abs(off_s) > 5e-3:  # twice the bounds of both
        assert apart[0] == pytest.approx(off_s, abs=3e-3)


def test_of_two_clocks_that_differ_neither_is_known_to_be_right() -> None:
    clocks = {k: (ClockModel("camera"), 0) for k in range(2)}
    for at_s in range(5):
        for k, (clock, _) in clocks.items():
            clock.add(ClockReading(at_s - 0.005 * k, float(at_s), 1e-5))
    assert apart_s(clocks, 4.0) == {0: pytest.approx(0.005, abs=1e-4), 1: pytest.approx(-0.005, abs=1e-4)}
