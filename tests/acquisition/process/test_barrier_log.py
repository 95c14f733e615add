"""The interruptions of one passage, whatever report of an edge was lost."""

from __future__ import annotations

from vaoi_station.acquisition.process.passages import BarrierLog, since_first


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


def test_the_way_of_the_belt_at_the_edges_is_that_of_the_encoder() -> None:
    log = BarrierLog()
    for blocked, clear in (((10.0, 2**32 - 100), (40.0, 900)), ((41.0, 920), None)):
        assert log.ways_mm(20.0) == (None if not log.interruptions else ((0.0, 50.0),))
        log.blocked(*blocked)
        if clear is not None:
            log.clear(*clear)
    assert log.ways_mm(20.0) == ((0.0, 50.0), (51.0, None)), "the counter wraps"
    log.clear(42.0)
    assert log.ways_mm(20.0) is None, "one edge came without a position"


def test_an_encoder_that_does_not_count_forwards_measures_no_way() -> None:
    for counts in (0, -40):
        log = BarrierLog()
        log.blocked(1.0, 1000)
        log.clear(2.0, 1000 + counts)
        assert log.ways_mm(20.0) is None
    log.blocked(3.0, 1600)
    log.clear(4.0, 1600 - 1)
    assert log.ways_mm(20.0) is None, "it counted backwards before"
    log = BarrierLog()
    log.blocked(1.0, 1000)
    log.clear(2.0, 1600)
    log.blocked(3.0, 1598)
    assert log.ways_mm(20.0) == ((0.0, 30.0), (29.9, None)), "a belt at rest shakes"


def test_an_interruption_after_the_end_of_the_run_begins_another_passage() -> None:
    log = BarrierLog()
    log.blocked(1.0)
    of_the_run = log.interruptions
    log.over = True
    log.blocked(7.0)
    assert of_the_run == [(1.0, None)]
    assert log.interruptions == [(7.0, None)]
    assert not log.over
