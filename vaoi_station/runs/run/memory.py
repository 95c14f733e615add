"""Which run has which bay of the ring, and where room for the next board comes from.

From a free bay; else from the oldest finished run without a lease. A run that is filmed or stitched
is never given away.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, Protocol

from vaoi_station.errors import BusyError, GoneError
from vaoi_station.runs.run.leases import Leases
from vaoi_station.runs.states.schemas import BayStatus

Use = Literal["free", "granted", "filming", "stitching", "finished"]


class Claims(Protocol):
    """What memory asks of the ring: `claim` gives a bay to a new run and returns its generation."""

    def claim(self, bay: int) -> int:
        """Blacken a bay and count its generation up."""


@dataclass(frozen=True)
class Bay:
    """Memory for one run, and its present use."""

    number: int
    use: Use = "free"
    run: str | None = None
    generation: int = 0
    finished: int = 0
    """Order of finishing; the lowest is the oldest."""


@dataclass(frozen=True)
class Granted:
    """A bay given to a coming run, and the run that had to go for it."""

    bay: Bay
    evicted: str | None


class Memory:
    """The bays of the ring."""

    def __init__(self, ring: Claims, bays: int, leases: Leases) -> None:
        self._ring = ring
        self._leases = leases
        self._bays = [Bay(k) for k in range(bays)]
        self._finished = 0

    def grant(self, run: str) -> Granted:
        """Make room for a coming run; `BusyError` names who holds the memory."""
        bay = self._room()
        if bay is None:
            raise BusyError(
                f"All {len(self._bays)} runs' worth of memory is in use: {self.holders()}.",
                action="Release a run or end a hold, or give [ring] runs more room."
                if self.held()
                else "It passes as soon as a run is stitched; more [ring] runs or more workers avoid it.",
                code="ring-full",
            )
        evicted = bay.run
        granted = Bay(bay.number, "granted", run, self._ring.claim(bay.number))
        self._bays[bay.number] = granted
        return Granted(granted, evicted)

    def use(self, run: str, use: Use) -> Bay:
        """A run goes on to another use of its bay."""
        bay = self.bay(run)
        if use == "finished":
            self._finished += 1
        self._bays[bay.number] = replace(bay, use=use, finished=self._finished)
        return self._bays[bay.number]

    def free(self, run: str) -> None:
        """A run gives its bay up; harmless if it has none."""
        for bay in self._bays:
            if bay.run == run:
                self._bays[bay.number] = Bay(bay.number, generation=bay.generation)
                self._leases.end_all(run)

    def bay(self, run: str) -> Bay:
        """The bay of a run; `GoneError` if its memory went to a later board."""
        for bay in self._bays:
            if bay.run == run:
                return bay
        raise GoneError(
            f"The frames of run {run} are no longer in memory.",
            action="Fetch pictures while the run is kept, hold it meanwhile, or give [ring] runs more room.",
            code="frames-gone",
        )

    def has(self, run: str) -> bool:
        """Whether a run has a bay."""
        return any(bay.run == run for bay in self._bays)

    def held(self) -> bool:
        """Whether somebody holds a finished run: then memory does not come back by itself."""
        return any(bay.use == "finished" and bay.run and self._leases.of(bay.run) for bay in self._bays)

    def bays(self) -> tuple[BayStatus, ...]:
        """All bays, as a status page shows them."""
        return tuple(BayStatus(bay=b.number, use=b.use, run=b.run) for b in self._bays)

    def holders(self) -> str:
        """In words, why no bay can be had."""
        parts = []
        for bay in self._bays:
            leases = self._leases.of(bay.run) if bay.run else ()
            who = ", ".join(f"{lease.holder} ({lease.purpose})" for lease in leases)
            parts.append(f"run {bay.run} is {f'held by {who}' if who else 'being ' + _DOING.get(bay.use, bay.use)}")
        return "; ".join(parts)

    def _room(self) -> Bay | None:
        free = [bay for bay in self._bays if bay.use == "free"]
        if free:
            return free[0]
        idle = [b for b in self._bays if b.use == "finished" and b.run and not self._leases.of(b.run)]
        return min(idle, key=lambda bay: bay.finished, default=None)


_DOING = {"granted": "awaited", "filming": "filmed", "stitching": "stitched", "finished": "kept"}
