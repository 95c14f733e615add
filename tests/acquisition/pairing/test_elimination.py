"""Elimination: forced choices only, and never a wrong one."""

from __future__ import annotations

from hypothesis import given
from hypothesis import strategies as st

from vaoi_station.acquisition.pairing.elimination import eliminate


def test_the_only_possibility_is_taken() -> None:
    assert eliminate([{3}]) == {0: 3}


def test_one_choice_may_settle_the_next() -> None:
    assert eliminate([{1, 2}, {1}, {2, 3, 1}]) == {1: 1, 0: 2, 2: 3}


def test_what_may_be_several_is_nobodys() -> None:
    assert eliminate([{1, 2}, {1, 2}]) == {}
    assert eliminate([set()]) == {}


def test_two_that_claim_the_same_get_nothing() -> None:
    assert eliminate([{1}, {1}, {4}]) == {2: 4}


@given(st.data())
def test_a_choice_is_never_wrong_and_does_not_depend_on_order(data: st.DataObject) -> None:
    truth = data.draw(st.lists(st.integers(0, 6), unique=True, max_size=7))
    sets = [{t, *data.draw(st.sets(st.integers(0, 6), max_size=3))} for t in truth]
    chosen = eliminate(sets)
    assert all(truth[n] == c for n, c in chosen.items())
    turned = eliminate(sets[::-1])
    assert {len(sets) - 1 - n: c for n, c in turned.items()} == chosen
