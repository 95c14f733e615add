"""Outcomes are taken in the order of the runs, whatever the order in which they come."""

from __future__ import annotations

from itertools import permutations
from pathlib import Path

from vaoi_station.plant.datasets.in_order import InOrder

OUTCOMES = [b"a", None, b"c", b""]


def test_every_order_of_arrival_gives_the_same(tmp_path: Path) -> None:
    for order in permutations(range(len(OUTCOMES))):
        taken: list[bytes] = []
        ordered = InOrder(tmp_path, taken.append)
        for number in order:
            ordered.put(number, OUTCOMES[number])
        assert taken == [b"a", b"c", b""]
        assert not list(tmp_path.iterdir())


def test_an_outcome_is_taken_as_soon_as_those_before_it_have_come(tmp_path: Path) -> None:
    taken: list[bytes] = []
    ordered = InOrder(tmp_path, taken.append)
    ordered.put(0, b"a")
    assert taken == [b"a"]
    ordered.put(2, b"c")
    assert taken == [b"a"]
    assert len(list(tmp_path.iterdir())) == 1, "it waits on the disk"
    ordered.put(1, None)
    assert taken == [b"a", b"c"]
