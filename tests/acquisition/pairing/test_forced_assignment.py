"""Tests of elimination: only forced assignments are made, and none is wrong."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.pairing.recorder import assign_forced


def test_a_single_candidate_is_assigned() -> None:
    assert assign_forced([{3}]) == {0: 3}


def test_one_assignment_may_force_the_next() -> None:
    assert assign_forced([{1, 2}, {1}, {2, 3, 1}]) == {1: 1, 0: 2, 2: 3}


def test_several_candidates_are_not_assigned() -> None:
    assert assign_forced([{1, 2}, {1, 2}]) == {}
    assert assign_forced([set()]) == {}


def test_two_sets_with_the_same_candidate_get_nothing() -> None:
    assert assign_forced([{1}, {1}, {4}]) == {2: 4}


@given(st.data())
def test_assignments_are_right_and_independent_of_order(data: st.DataObject) -> None:
    truth = data.draw(st.lists(st.integers(0, 6), unique=True, max_size=7))
    sets = [{t, *data.draw(st.sets(st.integers(0, 6), max_size=3))} for t in truth]
    chosen = assign_forced(sets)
    assert all(truth[n] == c for n, c in chosen.items())
    turned = assign_forced(sets[::-1])
    assert {len(sets) - 1 - n: c for n, c in turned.items()} == chosen
