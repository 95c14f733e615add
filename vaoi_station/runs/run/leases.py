"""Leases: a lease gives a holder the right to the frames of a run for a limited time. Leased memory is not evicted."""

from __future__ import annotations

import time
from collections.abc import Callable
from dataclasses import dataclass

from vaoi_station.errors import BusyError

MAX_HOLDERS = 32
"""Largest number of holders of one run. More holders mean that a caller uses a new name for every call."""
OWN = "rest "
"""Prefix of the holder's name in short leases of the station itself, which do not count for `MAX_HOLDERS`."""


@dataclass(frozen=True)
class Lease:
    """The right of one holder to the frames of one run, until `expires_s` by time.monotonic()."""

    run: str
    holder: str
    purpose: str
    expires_s: float

    def __str__(self) -> str:
        """Return the holder for messages, with the purpose if one was stated."""
        return f"{self.holder} ({self.purpose})" if self.purpose else self.holder


class Leases:
    """The leases of all runs. A lease that is not renewed expires, so that a crashed holder cannot block the line."""

    def __init__(self, lease_s: float, clock: Callable[[], float] = time.monotonic) -> None:
        self.lease_s = lease_s
        self._clock = clock
        self._leases: dict[tuple[str, str], Lease] = {}

    def take(self, run: str, holder: str, purpose: str) -> Lease:
        """Begin or renew a lease; `BusyError` if the run has `MAX_HOLDERS` other holders."""
        others = [lease.holder for lease in self.of_callers(run) if lease.holder != holder]
        if len(others) >= MAX_HOLDERS and not holder.startswith(OWN):
            raise BusyError(
                f"Run {run} has {len(others)} holders, which is the limit: {', '.join(others[:3])} …",
                action="Renew a hold under the name it was taken by, and end those that are not needed.",
                code="too-many-holders",
            )
        lease = Lease(run, holder, purpose, self._clock() + self.lease_s)
        # An earlier lease of the same holder is replaced: a renewal does not add a second lease.
        self._leases[run, holder] = lease
        return lease

    def end(self, run: str, holder: str) -> None:
        """End the lease of a holder. Nothing happens if there is no such lease."""
        self._leases.pop((run, holder), None)

    def end_all(self, run: str) -> None:
        """End all leases of a run whose memory is given up."""
        self._leases = {key: lease for key, lease in self._leases.items() if lease.run != run}

    def of(self, run: str) -> tuple[Lease, ...]:
        """Return the leases of one run that have not expired."""
        return tuple(lease for lease in self.all() if lease.run == run)

    def of_callers(self, run: str) -> tuple[Lease, ...]:
        """Return the leases of one run that callers hold, without the short ones of the station itself."""
        return tuple(lease for lease in self.of(run) if not lease.holder.startswith(OWN))

    def all(self) -> tuple[Lease, ...]:
        """Return all leases that have not expired, sorted by the age of their runs, oldest first."""
        now = self._clock()
        return tuple(sorted((le for le in self._leases.values() if le.expires_s > now), key=lambda le: le.run))

    def expire(self) -> tuple[Lease, ...]:
        """Remove the leases that have expired, and return them."""
        now = self._clock()
        # An expired lease has no effect even before this call, because `all` skips it.
        over = tuple(lease for lease in self._leases.values() if lease.expires_s <= now)
        for lease in over:
            del self._leases[lease.run, lease.holder]
        return over

    def remaining_s(self, lease: Lease) -> float:
        """Return the time until a lease expires; 0 if it has expired."""
        return max(0.0, lease.expires_s - self._clock())
