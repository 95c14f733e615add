"""Tests of the state of one run: nearest pulse, open rows, and the times of its rows."""

from __future__ import annotations

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.pairing.run_record import ObservedPulse, RunRecord
from vaoi_station.model import Pulse

PERIOD_S = 0.1


def record(*rows: int, light: str = "", exposures_us: tuple[float, ...] = ()) -> RunRecord:
    """Return a run with pulses of some rows; its device clock is 50 s ahead of the host's."""
    run = RunRecord("a", 0, PERIOD_S)
    for row in rows:
        pulse = Pulse(index=row, time_s=50.0 + row * PERIOD_S, light=light)
        run.pulses[row] = ObservedPulse(pulse, row * PERIOD_S, exposures_us)
    return run


def test_a_run_without_pulses_has_no_nearest_one_and_no_rows() -> None:
    assert record().nearest(1.0) is None
    assert record().rows == 0
    assert record().shortest_interval_s == PERIOD_S


@given(st.sets(st.integers(0, 20), min_size=1), st.floats(-1.0, 3.0))
def test_no_pulse_is_nearer_than_the_nearest(rows: set[int], host_s: float) -> None:
    run = record(*rows)
    found = run.nearest(host_s)
    assert found is not None
    row, error_s = found
    assert error_s == pytest.approx(host_s - run.pulses[row].host_s)
    assert all(abs(error_s) <= abs(host_s - pulse.host_s) for pulse in run.pulses.values())


def test_the_shortest_interval_is_that_of_neighbouring_pulses() -> None:
    assert record(0, 3, 5).shortest_interval_s == pytest.approx(2 * PERIOD_S)


def test_rows_are_those_of_the_pulses_until_the_run_has_ended() -> None:
    run = record(0, 2)
    assert run.rows == 3
    run.pulse_count = 5
    assert run.rows == 5


def test_open_rows_are_fired_rows_without_a_frame() -> None:
    run = record(0, 1, 2, 3)
    run.taken.add((0, 1))
    run.skipped[2] = "the LEDs must cool down"
    assert run.open_rows(0) == [0, 3]
    assert run.open_rows(1) == [0, 1, 3]


def test_times_are_relative_to_the_first_row() -> None:
    assert record(0, 1, 2).times_s() == (0.0, 0.1, 0.2)


def test_rows_without_a_report_follow_the_row_before_by_one_period() -> None:
    assert record(0, 2).times_s() == (0.0, 0.1, 0.2)
    run = record(1, 2)
    assert run.times_s() == (0.0, 0.1, 0.2), "the first report was lost"
    run.pulse_count = 4
    assert run.times_s() == (0.0, 0.1, 0.2, 0.3), "the last report was lost"


def test_lights_are_given_if_any_row_has_a_name() -> None:
    assert record(0, 1).lights() is None
    assert record(0, 2, light="ring").lights() == ("ring", "", "ring")


def test_exposures_are_given_only_if_all_rows_have_them() -> None:
    run = record(0, 1, exposures_us=(250.0, 100.0))
    assert run.exposures_us() == ((250.0, 100.0), (250.0, 100.0))
    run.pulse_count = 3
    assert run.exposures_us() is None
