"""Events come out once each and in order, whatever the serial port does to them."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.controller.protocol import Event, EventOrder, Kind


def event(number: int) -> Event:
    return Event(number, 10 * number, Kind.PULSE, 1, 0, 0)


def numbers(events: list[Event]) -> list[int]:
    return [e.number for e in events]


@given(st.lists(st.integers(0, 12), max_size=60))
def test_each_event_comes_out_once_and_in_order(arrivals: list[int]) -> None:
    order, passed = EventOrder(), list[int]()
    for number in arrivals:
        passed += numbers(order.add(event(number)))
    assert passed == list(range(len(passed)))
    first_gap = next(k for k in range(14) if k not in arrivals)
    assert len(passed) == first_gap == order.next_number


def test_an_early_event_waits_and_its_predecessor_is_missing() -> None:
    order = EventOrder()
    assert numbers(order.add(event(1))) == []
    assert order.missing() == 0
    assert numbers(order.add(event(0))) == [0, 1]
    assert order.missing() is None


def test_a_repeated_event_is_not_passed_on_again() -> None:
    order = EventOrder()
    order.add(event(0))
    assert order.add(event(0)) == []


def test_a_status_can_show_that_events_are_missing() -> None:
    order = EventOrder()
    order.announce(3)
    assert order.missing() == 0
    order.announce(1)
    assert order.missing() == 0, "a late status takes nothing back"


def test_what_was_overwritten_is_counted_and_what_arrived_early_is_kept() -> None:
    order = EventOrder()
    for number in (1, 4, 5):
        order.add(event(number))
    lost, events = order.skip_to(4)
    assert lost == 3  # 0, 2 and 3
    assert numbers(events) == [1, 4, 5]
    assert order.next_number == 6


@given(st.sets(st.integers(0, 20)), st.integers(0, 20))
def test_after_a_skip_nothing_before_it_is_missing(early: set[int], number: int) -> None:
    order = EventOrder()
    passed = [n for k in sorted(early) for n in numbers(order.add(event(k)))]
    lost, events = order.skip_to(number)
    passed += numbers(events)
    assert passed == sorted(set(passed))
    assert lost == sum(k not in early for k in range(number))
    assert (order.missing() or number) >= number
