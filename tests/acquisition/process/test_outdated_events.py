"""Late events: nothing counts after a run was given up, until its end, the next board, or an event of a new pulse."""

from __future__ import annotations

import pytest

from vaoi_station.acquisition.clocks import ClockModel, ClockReading
from vaoi_station.acquisition.controller.interface import BarrierBlocked, ControllerEvent, PulseFired, RunEnded
from vaoi_station.acquisition.process.passages import OutdatedEvents


def given_up() -> OutdatedEvents:
    clock = ClockModel("controller")
    clock.add(ClockReading(0.0, 100.0, 1e-5))
    outdated = OutdatedEvents(clock)
    outdated.give_up()
    return outdated


def pulse(host_s: float) -> PulseFired:
    return PulseFired(0, host_s - 100.0, 0)


@pytest.mark.parametrize("end", [RunEnded(0, 9.0, 1, "single"), BarrierBlocked(0, 9.0)])
def test_the_end_of_the_run_or_the_next_board_ends_it(end: ControllerEvent) -> None:
    outdated = given_up()
    assert outdated.has(pulse(108.0))
    assert outdated.has(end) is isinstance(end, RunEnded)
    assert not outdated.has(pulse(109.5))


def test_a_pulse_counts_by_its_time_on_the_clock_of_the_host() -> None:
    outdated = given_up()
    outdated.expect_pulse(110.0)
    assert outdated.has(pulse(109.0))
    assert not outdated.has(pulse(110.1))
    assert not outdated.has(pulse(109.0)), "one event in time ends it"


def test_nothing_is_outdated_after_disarming_or_for_a_pulse_without_anything_given_up() -> None:
    outdated = given_up()
    outdated.forget()
    outdated.expect_pulse(110.0)
    assert not outdated.has(pulse(1.0))
