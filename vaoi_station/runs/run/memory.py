"""The ring's bays: which run uses which, who holds its frames, and the grants of bays to coming runs.

The next board gets a free bay. If no bay is free, the run that finished first is evicted. A run is not evicted while a
caller holds it, before it is announced, and for a stated time after its announcement. A run that is filmed or stitched
is never evicted. If no run may be evicted, the next board is refused memory before it comes. A run of which a picture
is being made is evicted after all others: the picture is then given up.
"""

from __future__ import annotations

import math
import threading
import time
from collections.abc import Callable, Collection
from dataclasses import dataclass, replace
from typing import Any, Literal, NamedTuple, Protocol

from numpy.typing import NDArray

from vaoi_station.acquisition.process import messages
from vaoi_station.errors import BusyError, GoneError
from vaoi_station.model import Reason
from vaoi_station.runs.states.schemas import BayStatus, LeaseStatus
from vaoi_station.supervised_queue import SupervisedQueue

Use = Literal["free", "granted", "filming", "stitching", "finished"]
MAX_HOLDERS = 32
"""Largest number of holders of one run. More holders mean that a caller uses a new name for every call."""
OWN = "rest "
"""Prefix of the holder's name in short leases of the station itself, which do not count for `MAX_HOLDERS`."""
_IN_WORDS = {
    "granted": "reserved for the next board",
    "filming": "being filmed",
    "stitching": "being stitched",
}
_MOST = 1000
"""Largest number of commands that wait for a bay; there are some per second."""


@dataclass(frozen=True)
class Lease:
    """The right of one holder to the frames of one run, until `expires_s` by time.monotonic()."""

    run: str
    holder: str
    purpose: str
    expires_s: float

    def __str__(self) -> str:
        return f"{self.holder} ({self.purpose})" if self.purpose else self.holder


@dataclass(frozen=True)
class Bay:
    """Memory for the frames of one run, and its present use."""

    number: int
    use: Use = "free"
    run: str | None = None
    generation: int = 0
    finished: int = 0
    """Rank of the run in the order in which runs finished; the run with the lowest rank finished first."""
    kept_until_s: float = math.inf
    """Host time until which the frames of a finished run are not evicted; infinite until the run is announced."""


class FrameSource(Protocol):
    """Access to the frames of finished runs in the ring."""

    def bay_of(self, run: str) -> Bay:
        """Return the bay of a run. Raise GoneError if its frames are no longer in memory."""

    def busy(self) -> bool:
        """Return whether a board is being filmed or stitched."""

    def copier(self, bay: Bay) -> Callable[[int], NDArray[Any]]:
        """Return a function that copies the frame in a slot; it raises GoneError once the bay has another run."""


class GrantedBay(NamedTuple):
    """A bay that was granted to a coming run, and the run that was evicted for it (None if the bay was free)."""

    bay: Bay
    evicted: str | None


class Memory:
    """The bays, the runs that use them, and their leases. Used by the coordinator's thread only.

    A lease that is not renewed expires, so that a crashed holder cannot block the line.
    """

    def __init__(
        self, renew: Callable[[int], int], bays: int, lease_s: float, clock: Callable[[], float] = time.monotonic
    ) -> None:
        """Begin with free bays; `renew` raises the generation of a bay and returns it."""
        self._renew, self.lease_s, self._clock = renew, lease_s, clock
        self._bays = [Bay(k) for k in range(bays)]
        self._leases: dict[tuple[str, str], Lease] = {}
        self._finished = 0

    # --- leases

    def lease(self, run: str, holder: str, purpose: str) -> Lease:
        """Begin or renew a lease; `BusyError` if the run has `MAX_HOLDERS` other holders."""
        others = [lease.holder for lease in self.leases_of_callers(run) if lease.holder != holder]
        if len(others) >= MAX_HOLDERS and not holder.startswith(OWN):
            raise BusyError(
                f"Run {run} has {len(others)} holders, which is the limit: {', '.join(others[:3])} …",
                action="Renew a hold under the name it was taken by, and end those that are not needed.",
                code="too-many-holders",
            )
        self._leases[run, holder] = Lease(run, holder, purpose, self._clock() + self.lease_s)
        return self._leases[run, holder]

    def end_lease(self, run: str, holder: str) -> None:
        """End the lease of a holder. Nothing happens if there is no such lease."""
        self._leases.pop((run, holder), None)

    def leases(self) -> tuple[LeaseStatus, ...]:
        """Return the leases that have not expired, by the age of their runs, for `GET station` and the page."""
        present = sorted(self._present(), key=lambda lease: lease.run)
        return tuple(
            LeaseStatus(run=le.run, holder=le.holder, purpose=le.purpose, expires_in_s=self.remaining_s(le))
            for le in present
        )

    def leases_of_callers(self, run: str | None) -> tuple[Lease, ...]:
        """Return the leases of one run that callers hold, without the short ones of the station itself."""
        return tuple(lease for lease in self._present(run) if not lease.holder.startswith(OWN))

    def expire(self) -> tuple[Lease, ...]:
        """Remove the leases that have expired, and return them; they had no effect any more."""
        over = tuple(lease for lease in self._leases.values() if lease.expires_s <= self._clock())
        for lease in over:
            self.end_lease(lease.run, lease.holder)
        return over

    def remaining_s(self, lease: Lease) -> float:
        """Return the time until a lease expires; 0 if it has expired."""
        return max(0.0, lease.expires_s - self._clock())

    def _present(self, run: str | None = None) -> list[Lease]:
        now_s = self._clock()
        return [le for le in self._leases.values() if le.expires_s > now_s and run in (None, le.run)]

    # --- bays

    def grant(self, run: str) -> GrantedBay:
        """Grant a bay to a coming run; `BusyError`, which names the use of every bay, if none is available."""
        bay = next((bay for bay in self._bays if bay.use == "free"), None)
        if bay is None and (idle := self._evictable()):
            # The order in which runs finished counts, not that in which they began: a run that waited for late frames
            # has the newer result. Readers notice by the generation that pixels are gone. So a picture that is being
            # made need not keep a board waiting: a caller that may only read could otherwise stop the line.
            bay = min(idle, key=lambda b: (bool(self._present(b.run)), b.finished))
        if bay is None:
            raise BusyError(
                f"The memory for all {len(self._bays)} runs is in use: {self.holders()}.",
                action=self._remedy(),
                code="ring-full",
            )
        # The generation is raised, by which readers of the evicted run detect that its pixels are gone. They are set to
        # zero by `BayGrants`, not in this thread.
        granted = self._bays[bay.number] = Bay(bay.number, "granted", run, self._renew(bay.number))
        self._end_leases(bay.run)
        return GrantedBay(granted, bay.run)

    def available(self) -> int:
        """Return the count of bays that could be granted: free ones, and those whose runs may be evicted."""
        return sum(bay.use == "free" for bay in self._bays) + len(self._evictable())

    def use(self, run: str, use: Use) -> Bay:
        """Change the use of a run's bay, and return the bay. Raise GoneError if the run has no bay."""
        bay = self.bay(run)
        self._finished += use == "finished"
        changed = self._bays[bay.number] = replace(bay, use=use, finished=self._finished)
        return changed

    def keep(self, run: str, until_s: float) -> None:
        """Record that a finished run was announced, and keep its frames until a host time. No effect without a bay."""
        for bay in self._bays:
            if bay.run == run:
                self._bays[bay.number] = replace(bay, kept_until_s=until_s)

    def free(self, run: str) -> None:
        """Free the bay of a run and end the leases of the run. Nothing happens if the run has no bay."""
        for bay in self._bays:
            if bay.run == run:
                self._bays[bay.number] = Bay(bay.number, generation=bay.generation)
                self._end_leases(run)

    def reclaim(self, active: Collection[str]) -> tuple[str, ...]:
        """Free the bays that are filmed or stitched for runs that are not active, and return these runs.

        A fault at the end of a run, such as a result that cannot be stored, would otherwise keep its bay for ever.
        """
        used = [bay.run for bay in self._bays if bay.use in ("filming", "stitching") and bay.run is not None]
        lost = tuple(run for run in used if run not in active)
        for run in lost:
            self.free(run)
        return lost

    def bay(self, run: str) -> Bay:
        """Return the bay of a run. Raise GoneError if the run no longer has a bay."""
        for bay in self._bays:
            if bay.run == run:
                return bay
        raise GoneError(
            f"The frames of run {run} are no longer in memory.",
            action="Fetch pictures while the run is in memory, hold or pin the run, or increase [ring] runs.",
            code="frames-gone",
        )

    def has(self, run: str) -> bool:
        """Return whether a run has a bay."""
        return any(bay.run == run for bay in self._bays)

    def held(self) -> bool:
        """Return whether a caller holds a finished run, so that its memory is not available for the next board."""
        return any(bay.use == "finished" and self._held(bay) for bay in self._bays)

    def kept(self) -> bool:
        """Return whether a finished run is still kept for the callers to whom it was announced."""
        return any(bay.use == "finished" and bay.kept_until_s > self._clock() for bay in self._bays)

    def warning(self) -> Reason | None:
        """Return a warning if callers hold so much memory that boards have to wait for each other; else None."""
        left = sum(not self._held(bay) for bay in self._bays)
        # Boards that follow one another need at least two bays: one is filmed while callers read the one before.
        if left >= min(2, len(self._bays)):
            return None
        what = "no further board" if left == 0 else "one further board at a time"
        return Reason(
            code="memory-short",
            message=f"Holds leave memory for {what}: {self.holders()}.",
            action="Release runs or end holds; until then hold each board back until the line is armed again.",
        )

    def bays(self) -> tuple[BayStatus, ...]:
        """Return the use and the run of every bay, for `GET station` and the page."""
        return tuple(BayStatus(bay=b.number, use=b.use, run=b.run, generation=b.generation) for b in self._bays)

    def holders(self) -> str:
        """Return a phrase for messages that names the run and the use of every bay."""
        parts = []
        for bay in self._bays:
            who = ", ".join(map(str, self.leases_of_callers(bay.run))) if bay.run else ""
            parts.append(f"run {bay.run} is {f'held by {who}' if who else self._in_words(bay)}")
        return "; ".join(parts)

    def _in_words(self, bay: Bay) -> str:
        if bay.use != "finished":
            return _IN_WORDS.get(bay.use, bay.use)
        if math.isinf(bay.kept_until_s):
            return "being written to disk"
        left_s = bay.kept_until_s - self._clock()
        return f"kept for {math.ceil(left_s)} s more after its announcement" if left_s > 0 else "being kept"

    def _remedy(self) -> str:
        if self.held():
            return "Release a run, end a hold, or increase [ring] runs."
        if self.kept():
            return "Release a run, or wait until it is no longer kept; increase [ring] runs or lower [ring] keep_s."
        return "Wait until a run is stitched; increase [ring] runs or workers to avoid this."

    def _held(self, bay: Bay) -> bool:
        return bay.run is not None and bool(self.leases_of_callers(bay.run))

    def _end_leases(self, run: str | None) -> None:
        self._leases = {key: lease for key, lease in self._leases.items() if lease.run != run}

    def _evictable(self) -> list[Bay]:
        now_s = self._clock()
        return [b for b in self._bays if b.use == "finished" and b.kept_until_s <= now_s and not self._held(b)]


class Commands(Protocol):
    """Takes commands for the acquisition process."""

    def send(self, command: messages.Command) -> None:
        """Send a command, without waiting for its effect."""


class BayGrants:
    """Passes commands to the acquisition process, and blackens each bay before its grant. Usable from any thread.

    The coordinator raises the bay's generation, by which readers of the run before notice that its pixels are gone, and
    goes on; commands after a grant wait until the bay is black. A bay is not blackened before it is granted, although
    it may be free for long: a camera that was late may still write to a slot of a run that is over (`SlotQueue`).
    """

    def __init__(self, blacken: Callable[[int], object], link: Commands) -> None:
        """Prepare the thread; `blacken` sets all pixels of a bay to zero."""
        self._blacken, self._link = blacken, link
        self._queue: SupervisedQueue[tuple[int, messages.Command]] = SupervisedQueue(
            self._pass_on, "bays", _MOST, limited=True
        )
        self.thread, self.start, self.stop = self._queue.thread, self._queue.start, self._queue.stop
        self._lock, self._process = threading.Lock(), 0
        """The lock, and the number of the acquisition process for which new commands are meant."""

    def send(self, command: messages.Command) -> None:
        """Send a command, behind those before it. Returns at once."""
        self._queue.put((self._process, command))

    def forget(self) -> None:
        """Give up the commands that were not sent yet: the acquisition process for which they were meant has ended."""
        with self._lock:
            self._process += 1

    def _pass_on(self, waiting: tuple[int, messages.Command]) -> None:
        process, command = waiting
        grant = command.grant if isinstance(command, messages.FireTrial) else command
        if isinstance(grant, messages.Grant) and process == self._process:
            self._blacken(grant.bay)
        with self._lock:
            if process == self._process:
                self._link.send(command)
