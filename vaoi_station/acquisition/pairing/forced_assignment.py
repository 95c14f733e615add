"""Assign incomplete frames to pulses by elimination.

An incomplete frame has no trustworthy time stamp or id. It belongs to some pulse of its camera, at most one frame
belongs to each pulse, and no frame arrives before its pulse. So each frame has a set of candidate pulses. A frame with
exactly one candidate is assigned to it, which may leave other frames with one candidate. A frame with several
candidates is not assigned.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Sequence
from collections.abc import Set as AbstractSet
from typing import TypeVar

T = TypeVar("T", bound=Hashable)


def assign_forced(candidates: Sequence[AbstractSet[T]]) -> dict[int, T]:
    """Give each candidate set that has only one possible element this element; return {index of the set: element}.

    If two sets are left with the same single element, neither of them gets it.
    """
    left = [set(c) for c in candidates]
    chosen: dict[int, T] = {}
    while True:
        single = {n: next(iter(c)) for n, c in enumerate(left) if len(c) == 1 and n not in chosen}
        claims = Counter(single.values())
        forced = {n: c for n, c in single.items() if claims[c] == 1}
        if not forced:
            return chosen
        chosen.update(forced)
        for n, c in enumerate(left):
            if n not in chosen:
                c -= set(forced.values())
