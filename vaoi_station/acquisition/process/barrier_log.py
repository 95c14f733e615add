"""The interruptions of the barrier from the beginning of one passage on."""

from __future__ import annotations

from collections.abc import Sequence
from itertools import pairwise

from vaoi_station.acquisition.pairing.run_record import Interruption

BACKWARDS_COUNTS = 20
"""Counts backwards between two edges from which on an encoder is not trusted: a belt at rest may shake by a few."""
_WRAP = 1 << 32


class BarrierLog:
    """Collects the edges of the barrier during one passage: of a run, and of what stays in the barrier after its end.

    Times are those of the controller's clock, s.
    """

    def __init__(self) -> None:
        self.interruptions: list[Interruption] = []
        self._counts: list[tuple[int | None, int | None]] = []
        """Positions of the encoder at the edges of each interruption, as far as they are known."""
        self.over = False
        """Whether the run of this passage has ended; the next interruption belongs to another passage."""

    def blocked(self, time_s: float, counts: int | None = None) -> None:
        """Add the beginning of an interruption of the barrier, at a position of the encoder."""
        if self.over:
            self.interruptions, self._counts, self.over = [], [], False
        self.interruptions.append((time_s, None))
        self._counts.append((counts, None))

    @property
    def is_open(self) -> bool:
        """Whether the barrier was still interrupted at the last edge of this passage."""
        return bool(self.interruptions) and self.interruptions[-1][1] is None

    def clear(self, time_s: float, counts: int | None = None) -> None:
        """Add the end of an interruption of the barrier, at a position of the encoder."""
        # If the report of a beginning was lost, the previous interruption is taken to have lasted until now: an
        # interruption that is too long is noticed, one that is missing is not.
        if self.interruptions:
            self.interruptions[-1] = (self.interruptions[-1][0], time_s)
            self._counts[-1] = (self._counts[-1][0], counts)

    def ways_mm(self, counts_per_mm: float) -> tuple[Interruption, ...] | None:
        """Return the way of the belt at each edge since the first one, mm, by the encoder; None if it is not known.

        It is not known either if the encoder did not count forwards while something passed: it is not connected then.
        """
        if not self._counts or (zero := self._counts[0][0]) is None:
            return None
        ways: list[tuple[int, int | None]] = []
        for (blocked, clear), (_, clear_s) in zip(self._counts, self.interruptions, strict=True):
            if blocked is None or (clear is None and clear_s is not None):
                return None
            ways.append((_way(zero, blocked), None if clear is None else _way(zero, clear)))
        edges = [way for pair in ways for way in pair if way is not None]
        if edges[-1] <= 0 or any(after - before <= -BACKWARDS_COUNTS for before, after in pairwise(edges)):
            return None
        return tuple((b / counts_per_mm, None if c is None else c / counts_per_mm) for b, c in ways)


def _way(zero: int, counts: int) -> int:
    """Return the counts from one position to another, of a counter of 32 bits."""
    return (counts - zero + _WRAP // 2) % _WRAP - _WRAP // 2


def since_first(interruptions: Sequence[Interruption]) -> tuple[Interruption, ...]:
    """Return interruptions relative to the beginning of the first one, in s."""
    zero_s = interruptions[0][0] if interruptions else 0.0
    return tuple((b - zero_s, None if c is None else c - zero_s) for b, c in interruptions)
