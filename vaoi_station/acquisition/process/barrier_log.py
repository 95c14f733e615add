"""The interruptions of the barrier from the beginning of one passage on."""

from __future__ import annotations

from collections.abc import Sequence

from vaoi_station.acquisition.pairing.run_record import Interruption


class BarrierLog:
    """Collects the edges of the barrier during one passage: of a run, and of what stays in the barrier after its end.

    Times are those of the controller's clock, s.
    """

    def __init__(self) -> None:
        self.interruptions: list[Interruption] = []
        self.over = False
        """Whether the run of this passage has ended; the next interruption belongs to another passage."""

    def blocked(self, time_s: float) -> None:
        """Add the beginning of an interruption of the barrier."""
        if self.over:
            self.interruptions, self.over = [], False
        self.interruptions.append((time_s, None))

    @property
    def is_open(self) -> bool:
        """Whether the barrier was still interrupted at the last edge of this passage."""
        return bool(self.interruptions) and self.interruptions[-1][1] is None

    def clear(self, time_s: float) -> None:
        """Add the end of an interruption of the barrier."""
        # If the report of a beginning was lost, the previous interruption is taken to have lasted until now: an
        # interruption that is too long is noticed, one that is missing is not.
        if self.interruptions:
            self.interruptions[-1] = (self.interruptions[-1][0], time_s)


def since_first(interruptions: Sequence[Interruption]) -> tuple[Interruption, ...]:
    """Return interruptions relative to the beginning of the first one, in s."""
    zero_s = interruptions[0][0] if interruptions else 0.0
    return tuple((b - zero_s, None if c is None else c - zero_s) for b, c in interruptions)
