"""Tests of the state of one run: nearest pulse, open rows, and the times of its rows."""

from __future__ import annotations

from itertools import pairwise

import pytest
from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.controller.interface import PulseSkipped
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
    run.skipped[2] = PulseSkipped(0, 50.2, 2, "the LEDs must cool down")
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


def on_belt(times_s: dict[int, float]) -> RunRecord:
    """Return a run whose pulses have these times by the controller's clock."""
    run = RunRecord("a", 0, PERIOD_S)
    run.pulses = {row: ObservedPulse(Pulse(index=row, time_s=s), s) for row, s in times_s.items()}
    return run


def test_rows_without_a_report_follow_the_belt_not_the_period() -> None:
    """The belt is 1.25 times as fast as planned, then slower; the trigger period is 0.1 s."""
    assert on_belt({0: 0.0, 1: 0.08, 4: 0.32}).times_s() == (0.0, 0.08, 0.16, 0.24, 0.32)
    run = on_belt({2: 0.0, 3: 0.08, 4: 0.24})
    run.pulse_count = 6
    assert run.times_s() == (0.0, 0.08, 0.16, 0.24, 0.4, 0.56)


def test_a_skipped_row_has_the_time_at_which_it_was_due() -> None:
    run = on_belt({0: 0.0, 3: 0.3})
    run.skipped = {row: PulseSkipped(row, s, row, "too fast") for row, s in ((1, 0.07), (2, 0.05), (9, 0.9))}
    assert run.times_s() == (0.0, 0.07, 0.185, 0.3), "the report of row 2 is out of order"


@given(st.data())
def test_times_increase_whatever_was_skipped_or_lost(data: st.DataObject) -> None:
    intervals_s = data.draw(st.lists(st.floats(0.001, 3.0), min_size=2, max_size=12))
    times_s = [sum(intervals_s[:n]) for n in range(1, len(intervals_s) + 1)]
    rows = data.draw(st.sets(st.sampled_from(range(len(times_s))), min_size=1))
    run = on_belt({row: times_s[row] for row in rows})
    run.pulse_count = len(times_s)
    for row in data.draw(st.sets(st.sampled_from(range(len(times_s))))) - rows:
        run.skipped[row] = PulseSkipped(row, data.draw(st.floats(0, 40)), row, "too fast")
    found = run.times_s()
    assert len(found) == len(times_s)
    assert all(a < b for a, b in pairwise(found))


def test_lights_are_given_if_any_row_has_a_name() -> None:
    assert record(0, 1).lights() is None
    assert record(0, 2, light="ring").lights() == ("ring", "", "ring")


def test_exposures_are_given_only_if_all_rows_have_them() -> None:
    run = record(0, 1, exposures_us=(250.0, 100.0))
    assert run.exposures_us() == ((250.0, 100.0), (250.0, 100.0))
    run.pulse_count = 3
    assert run.exposures_us() is None


def lit(on_us: dict[int, float | None], shutters_us: tuple[float, ...] = (250.0, 40.0)) -> RunRecord:
    """Return a run without a program, whose controller reports the on-times of the LEDs."""
    run = RunRecord("a", 0, PERIOD_S, shutters_us=shutters_us)
    for row, lit_us in on_us.items():
        pulse = Pulse(index=row, time_s=50.0 + row * PERIOD_S, light="ring")
        run.pulses[row] = ObservedPulse(pulse, row * PERIOD_S, on_us=lit_us)
    return run


def test_without_a_program_leds_that_are_on_shortly_determine_the_exposures() -> None:
    run = lit({0: 100.0, 1: 60.0, 2: 30.0, 3: 400.0, 4: 0.0})
    assert run.exposures_us() == ((100.0, 40.0), (60.0, 40.0), (30.0, 30.0), (250.0, 40.0), (250.0, 40.0))
    assert run.taken_with(1) == ((60.0, 40.0), ())
    # A lost report must not cost the other rows their exposures.
    run.pulse_count = 6
    assert run.exposures_us() == (*((100.0, 40.0), (60.0, 40.0), (30.0, 30.0)), *((250.0, 40.0),) * 3)


def test_leds_that_are_on_for_longer_than_all_shutters_change_no_exposure() -> None:
    assert lit({0: 250.0, 1: 300.0}).exposures_us() is None
    assert lit({0: None, 1: 0.0}).exposures_us() is None
    assert lit({0: 100.0}, shutters_us=()).exposures_us() is None
