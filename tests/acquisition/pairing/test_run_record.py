"""Tests of the state of one run: nearest pulse, open rows, and the times of its rows."""

from __future__ import annotations

from dataclasses import replace
from itertools import pairwise

from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.controller.interface import PulseFired, PulseSkipped
from vaoi_station.acquisition.pairing.run_record import ObservedPulse, RunRecord

PERIOD_S = 0.1


def on_belt(times_s: dict[int, float]) -> RunRecord:
    """Return a run whose pulses have these times by the controller's clock."""
    run = RunRecord("a", 0, PERIOD_S)
    run.pulses = {row: ObservedPulse(PulseFired(0, s, row), s) for row, s in times_s.items()}
    return run


def test_rows_without_a_report_follow_the_belt_not_the_period() -> None:
    """The belt is 1.25 times as fast as planned, then slower; the trigger period is 0.1 s."""
    assert on_belt({0: 0.0, 1: 0.08, 4: 0.32}).times_s() == (0.0, 0.08, 0.16, 0.24, 0.32)
    run = on_belt({2: 0.0, 3: 0.08, 4: 0.24})
    run.pulse_count = 6
    assert run.times_s() == (0.0, 0.08, 0.16, 0.24, 0.4, 0.56)


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


def lit(on_us: dict[int, float | None], shutters_us: tuple[float, ...] = (250.0, 40.0)) -> RunRecord:
    """Return a run without a program, whose controller reports the on-times of the LEDs."""
    run = RunRecord("a", 0, PERIOD_S, shutters_us=shutters_us)
    for row, lit_us in on_us.items():
        pulse = PulseFired(0, 50.0 + row * PERIOD_S, row, "ring")
        run.pulses[row] = ObservedPulse(replace(pulse, on_us=lit_us), row * PERIOD_S)
    return run


def test_without_a_program_leds_that_are_on_shortly_determine_the_exposures() -> None:
    run = lit({0: 100.0, 1: 60.0, 2: 30.0, 3: 400.0, 4: 0.0})
    assert run.exposures_us() == ((100.0, 40.0), (60.0, 40.0), (30.0, 30.0), (250.0, 40.0), (250.0, 40.0))
    assert run.taken_with(1) == ((60.0, 40.0), ())
    # A lost report must not cost the other rows their exposures.
    run.pulse_count = 6
    assert run.exposures_us() == (*((100.0, 40.0), (60.0, 40.0), (30.0, 30.0)), *((250.0, 40.0),) * 3)
