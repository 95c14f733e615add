"""Which frame is it? The only one it can be, or nobody's.

An incomplete frame carries no trustworthy time or number. It came from some pulse of its camera, at most
one frame came from each, and none can arrive before its pulse; so each has a set of candidates. Where
these sets leave exactly one possibility it is taken, which may settle others in turn; where they leave
several, none is.
"""

from __future__ import annotations

from collections import Counter
from collections.abc import Hashable, Sequence
from collections.abc import Set as AbstractSet
from typing import TypeVar

T = TypeVar("T", bound=Hashable)


def eliminate(candidates: Sequence[AbstractSet[T]]) -> dict[int, T]:
    """The forced choices: index of a set → its element. Two sets that are left with the same one get nothing."""
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
