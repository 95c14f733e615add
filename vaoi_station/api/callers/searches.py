"""Threads and seats of their own for searches in the history and for long lists.

A search reads up to 20,000 rows, and the list of components of a large board is some megabytes of text. In the threads
of commands, many of them at a time would let disarming and matrices wait.
"""

from __future__ import annotations

from collections.abc import AsyncIterator, Callable
from typing import TypeVar

from fastapi import Request

from vaoi_station.api.callers.caller import caller_of
from vaoi_station.api.callers.seats import QueuedSeats
from vaoi_station.api.callers.thread_limit import ThreadLimit

T = TypeVar("T")
THREADS = 2
"""Number of searches at the same time; the database has more readers, which stay for others."""
SEARCHES, SEARCHES_OF_CALLER = 4, 2
"""Largest number of answers, in all and of one caller, that are made or not yet read."""
WAITING = 24
WAIT_S = 20.0


class Searches(QueuedSeats):
    """The seats for searches and long lists, and the threads in which they are made."""

    def __init__(self) -> None:
        super().__init__("searches and long lists", SEARCHES, SEARCHES_OF_CALLER, WAITING, WAIT_S)
        self._threads = ThreadLimit(THREADS)

    async def hold(self, request: Request) -> AsyncIterator[None]:
        """Hold a seat until the caller has read its answer; a dependency of routes."""
        async with self.take(caller_of(request).name):
            yield

    async def ask(self, call: Callable[..., T], *args: object) -> T:
        """Run a search in one of the threads, for a request that holds a seat."""
        return await self._threads.ask(call, *args)
