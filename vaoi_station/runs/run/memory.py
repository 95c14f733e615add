"""Assignment of the ring's bays to runs, and eviction.

The next board gets a free bay, else that of the oldest finished run without a lease. The bay of a run that is filmed or
stitched is never evicted.
"""

from __future__ import annotations

from dataclasses import dataclass, replace
from typing import Literal, Protocol

from vaoi_station.errors import BusyError, GoneError
from vaoi_station.runs.run.leases import Leases
from vaoi_station.runs.states.schemas import BayStatus

Use = Literal["free", "granted", "filming", "stitching", "finished"]


class BayRing(Protocol):
    """The ring, as far as bays are assigned in it."""

    def claim(self, bay: int) -> int:
        """Zero a bay's pixels and return its new generation."""


@dataclass(frozen=True)
class Bay:
    """Memory for one run, and its present use."""

    number: int
    use: Use = "free"
    run: str | None = None
    generation: int = 0
    finished: int = 0
    """Rank in the order of finishing; the lowest finished first."""


@dataclass(frozen=True)
class GrantedBay:
    """A bay granted to a coming run, and the run that was evicted for it."""

    bay: Bay
    evicted: str | None


class Memory:
    """The bays of the ring and their runs; confined to the coordinator's thread."""

    def __init__(self, ring: BayRing, bays: int, leases: Leases) -> None:
        self._ring = ring
        self._leases = leases
        self._bays = [Bay(k) for k in range(bays)]
        self._finished = 0

    def grant(self, run: str) -> GrantedBay:
        """Grant a bay to a coming run; `BusyError` names the holders of the memory if there is none."""
        bay = self._next_bay()
        if bay is None:
            raise BusyError(
                f"The memory for all {len(self._bays)} runs is in use: {self.holders()}.",
                action="Release a run, end a hold, or increase [ring] runs."
                if self.held()
                else "Wait until a run is stitched; increase [ring] runs or workers to avoid this.",
                code="ring-full",
            )
        # The claim raises the generation: readers of the evicted run's slots notice that their pixels are gone.
        evicted = bay.run
        granted = Bay(bay.number, "granted", run, self._ring.claim(bay.number))
        self._bays[bay.number] = granted
        return GrantedBay(granted, evicted)

    def use(self, run: str, use: Use) -> Bay:
        """Change the use of a run's bay."""
        bay = self.bay(run)
        if use == "finished":
            self._finished += 1
        self._bays[bay.number] = replace(bay, use=use, finished=self._finished)
        return self._bays[bay.number]

    def free(self, run: str) -> None:
        """Free a run's bay and end its leases; harmless if it has none."""
        for bay in self._bays:
            if bay.run == run:
                self._bays[bay.number] = Bay(bay.number, generation=bay.generation)
                self._leases.end_all(run)

    def bay(self, run: str) -> Bay:
        """Return the bay of a run; `GoneError` if its memory was given to a later board."""
        for bay in self._bays:
            if bay.run == run:
                return bay
        raise GoneError(
            f"The frames of run {run} are no longer in memory.",
            action="Fetch pictures while the run is in memory, hold the run, or increase [ring] runs.",
            code="frames-gone",
        )

    def has(self, run: str) -> bool:
        """Whether a run has a bay."""
        return any(bay.run == run for bay in self._bays)

    def held(self) -> bool:
        """Whether a finished run is held: its memory does not become free when a stitch ends."""
        return any(bay.use == "finished" and bay.run and self._leases.of(bay.run) for bay in self._bays)

    def bays(self) -> tuple[BayStatus, ...]:
        """All bays, as a status page shows them."""
        return tuple(BayStatus(bay=b.number, use=b.use, run=b.run) for b in self._bays)

    def holders(self) -> str:
        """Return a sentence part that names the run and the use of every bay."""
        parts = []
        for bay in self._bays:
            leases = self._leases.of(bay.run) if bay.run else ()
            who = ", ".join(f"{lease.holder} ({lease.purpose})" for lease in leases)
            parts.append(f"run {bay.run} is {f'held by {who}' if who else _IN_WORDS.get(bay.use, bay.use)}")
        return "; ".join(parts)

    def _next_bay(self) -> Bay | None:
        free = [bay for bay in self._bays if bay.use == "free"]
        if free:
            return free[0]
        # Finished first, not begun first: a run that waited for late frames is still the younger result.
        idle = [b for b in self._bays if b.use == "finished" and b.run and not self._leases.of(b.run)]
        return min(idle, key=lambda bay: bay.finished, default=None)


_IN_WORDS = {
    "granted": "reserved for the next board",
    "filming": "being filmed",
    "stitching": "being stitched",
    "finished": "being kept",
}
