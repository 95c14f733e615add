"""Limits of the resources in use at a time, by one caller and in total: waiting requests, pictures, bytes of bodies.

A *seat* is one unit of such a resource, for example one waiting request.
"""

from __future__ import annotations

import asyncio
import sys
from collections import Counter
from collections.abc import AsyncIterator, Iterator
from contextlib import asynccontextmanager, contextmanager

from vaoi_station.errors import BusyError


class Seats:
    """A number of seats, limited in total and for each caller. A request for which no seat is free is refused."""

    def __init__(self, what: str, total: int, per_caller: int) -> None:
        """Create the seats; `what` is what callers have seats for, in the plural, for messages, such as "pictures"."""
        self._what, self._total, self._per_caller = what, total, per_caller
        self._taken: Counter[str] = Counter()

    @property
    def taken(self) -> int:
        """Number of seats that callers hold at present."""
        return self._taken.total()

    @contextmanager
    def take(self, caller: str, count: int = 1) -> Iterator[None]:
        """Take seats in a `with` block. Raise BusyError if the caller, or all callers together, would have too many."""
        if self._taken[caller] + count > self._per_caller:
            raise BusyError(
                f"{caller} has {self._taken[caller]} {self._what}, the limit for one caller is {self._per_caller}.",
                action="Close some of them, or wait until they end.",
            )
        if self.taken + count > self._total:
            raise BusyError(f"All callers together have {self.taken} {self._what}; the limit is {self._total}.")
        self._taken[caller] += count
        try:
            yield
        finally:
            self._taken[caller] -= count
            if not self._taken[caller]:
                # If callers without seats stayed in the counter, it would grow with every new address.
                del self._taken[caller]


class QueuedSeats:
    """Seats for which callers wait in turn: a limited number of requests, for a limited time."""

    def __init__(self, what: str, total: int, per_caller: int, queue: int, wait_s: float) -> None:
        """Create the seats. Of each caller `queue` requests may wait, each for at most `wait_s`."""
        # The limit of connections also limits the total number of waiting requests.
        self._queue = Seats(f"{what}, waiting ones included", sys.maxsize, per_caller + queue)
        self._what = what
        self._total, self._per_caller, self._wait_s = total, per_caller, wait_s
        self._held: Counter[str] = Counter()
        self._changed = asyncio.Event()

    @asynccontextmanager
    async def take(self, caller: str) -> AsyncIterator[None]:
        """Take a seat in an `async with` block; if necessary, wait for it. Raise BusyError if none becomes free."""
        with self._queue.take(caller):
            try:
                async with asyncio.timeout(self._wait_s):
                    while not self._free(caller):
                        await self._changed.wait()
            except TimeoutError:
                raise BusyError(
                    f"For {self._wait_s:g} s no other of the {self._what} could be made, because as many as the limit "
                    "allows were being made or not yet read.",
                    action="Send fewer such requests at a time, and read each answer.",
                ) from None
            # There was no `await` since the test, so no other request can have taken the seat.
            self._held[caller] += 1
            try:
                yield
            finally:
                self._held[caller] -= 1
                if not self._held[caller]:
                    del self._held[caller]
                self._changed.set()
                self._changed = asyncio.Event()

    def _free(self, caller: str) -> bool:
        return self._held.total() < self._total and self._held[caller] < self._per_caller
