"""The callers of requests, and the share of the station's resources that each may use at a time.

A *seat* is one unit of such a resource, for example one waiting request. Commands, searches and pictures have separate
threads, so that a burst of pictures does not delay arming.
"""

from __future__ import annotations

import asyncio
import ipaddress
from collections import Counter
from collections.abc import AsyncIterator, Callable, Iterator
from contextlib import asynccontextmanager, contextmanager
from dataclasses import dataclass
from functools import lru_cache, partial
from typing import TypeVar

import anyio
import anyio.to_thread
from fastapi import Request
from starlette.types import Scope

from vaoi_station.errors import BusyError
from vaoi_station.files.access_keys import AccessKey

T = TypeVar("T")
WAITING, WAIT_S = 24, 20.0
"""Requests of one caller that wait for a seat for pictures, searches or figures, and their longest wait, s."""
_KEY = "caller"


@dataclass(frozen=True)
class Caller:
    """The sender of a request."""

    address: str
    """IP address (for IPv6 the network) by which the caller is counted."""
    key: str | None = None
    """Name of the caller's key; None without a key."""
    scopes: frozenset[str] = frozenset()
    access_key: AccessKey | None = None
    """The key itself, as it was when the request began."""

    @property
    def name(self) -> str:
        """Name under which the caller's use of resources is counted."""
        return self.address if self.key is None else f"key {self.key}"


def set_caller(scope: Scope, caller: Caller | None = None) -> Caller:
    """Store the caller of a request in its scope, and return it; by default one without a key."""
    if caller is None:
        client = scope.get("client")
        caller = Caller(caller_address(client[0]) if client else "local")
    scope.setdefault("state", {})[_KEY] = caller
    return caller


def caller_in(scope: Scope) -> Caller:
    """Return the caller that `set_caller` has stored in the scope of a request."""
    caller: Caller = scope["state"][_KEY]
    return caller


def caller_of(request: Request) -> Caller:
    """Return the caller of a request."""
    return caller_in(request.scope)


@lru_cache(1024)
def caller_address(host: str) -> str:
    """Return the address by which a caller is counted; for IPv6 the network, in which one host has 2^64 addresses."""
    try:
        address = ipaddress.ip_address(host.partition("%")[0])
    except ValueError:
        return host
    if isinstance(address, ipaddress.IPv6Address):
        if address.ipv4_mapped is not None:
            return str(address.ipv4_mapped)
        if not address.is_loopback:
            return str(ipaddress.ip_network((address, 64), strict=False))
    return str(address)


class Seats:
    """Seats that are limited in total and for each caller. A request for which no seat is free is refused."""

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
        with _counted(self._taken, caller, count):
            yield

    async def hold(self, request: Request) -> AsyncIterator[None]:
        """Hold a seat until the caller has read its answer: a dependency of a route ends after the reply was sent."""
        with self.take(caller_of(request).name):
            yield


class QueuedSeats:
    """Seats for which callers wait in turn: a limited number of requests, for a limited time."""

    def __init__(self, what: str, total: int, per_caller: int, queue: int = WAITING, wait_s: float = WAIT_S) -> None:
        """Create the seats. Of each caller `queue` requests may wait, each for at most `wait_s`."""
        # The limit of connections also limits the total number of waiting requests.
        self._queue = Seats(f"{what}, waiting ones included", 1 << 30, per_caller + queue)
        self._what, self._total, self._per_caller, self._wait_s = what, total, per_caller, wait_s
        self._held: Counter[str] = Counter()
        self._changed = asyncio.Event()

    @asynccontextmanager
    async def take(self, caller: str) -> AsyncIterator[None]:
        """Take a seat in an `async with` block; if necessary, wait for it. Raise BusyError if none becomes free."""
        with self._queue.take(caller):
            try:
                async with asyncio.timeout(self._wait_s):
                    while self._held.total() >= self._total or self._held[caller] >= self._per_caller:
                        await self._changed.wait()
            except TimeoutError:
                raise BusyError(
                    f"For {self._wait_s:g} s no other of the {self._what} could be made, because as many as the limit "
                    "allows were being made or not yet read.",
                    action="Send fewer such requests at a time, and read each answer.",
                ) from None
            # There was no `await` since the test, so no other request can have taken the seat.
            try:
                with _counted(self._held, caller):
                    yield
            finally:
                self._changed.set()
                self._changed = asyncio.Event()

    async def hold(self, request: Request) -> AsyncIterator[None]:
        """Hold a seat as `Seats.hold` does."""
        async with self.take(caller_of(request).name):
            yield


@contextmanager
def _counted(seats: Counter[str], caller: str, count: int = 1) -> Iterator[None]:
    seats[caller] += count
    try:
        yield
    finally:
        seats[caller] -= count
        if not seats[caller]:
            # If callers without seats stayed in the counter, it would grow with every new address.
            del seats[caller]


class ThreadLimit:
    """A limited number of threads that run blocking calls."""

    def __init__(self, threads: int) -> None:
        self._limiter = anyio.CapacityLimiter(threads)

    async def ask(self, call: Callable[..., T], *args: object) -> T:
        """Run a blocking call in a thread of the pool. If all threads are busy, wait until one is free."""
        return await anyio.to_thread.run_sync(partial(call, *args), limiter=self._limiter)

    async def listen(self, call: Callable[..., T], *args: object) -> T:
        """Run a blocking call that changes nothing. If the request is cancelled, do not wait for the call's end."""
        return await anyio.to_thread.run_sync(partial(call, *args), limiter=self._limiter, abandon_on_cancel=True)
