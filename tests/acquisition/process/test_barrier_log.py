"""The interruptions of one passage, whatever report of an edge was lost."""

from __future__ import annotations

from vaoi_station.acquisition.process.barrier_log import BarrierLog, since_first


def test_interruptions_are_collected_in_order() -> None:
    log = BarrierLog()
    states = [log.is_open]
    log.blocked(10.0)
    states.append(log.is_open)
    log.clear(11.0)
    states.append(log.is_open)
    assert states == [False, True, False]
    log.blocked(12.0)
    assert log.interruptions == [(10.0, 11.0), (12.0, None)]
    assert since_first(log.interruptions) == ((0.0, 1.0), (2.0, None))
    assert since_first([]) == ()


def test_a_second_end_extends_the_interruption_because_its_beginning_was_lost() -> None:
    log = BarrierLog()
    log.clear(1.0)
    assert log.interruptions == []
    log.blocked(2.0)
    log.clear(3.0)
    log.clear(5.0)
    assert log.interruptions == [(2.0, 5.0)]


def test_an_interruption_after_the_end_of_the_run_begins_another_passage() -> None:
    log = BarrierLog()
    log.blocked(1.0)
    of_the_run = log.interruptions
    log.over = True
    log.blocked(7.0)
    assert of_the_run == [(1.0, None)]
    assert log.interruptions == [(7.0, None)]
    assert not log.over
