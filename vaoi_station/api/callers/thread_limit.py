"""Blocking calls in bounded thread pools.

Commands, searches and pictures have separate pools, so that a burst of pictures does not delay arming.
"""

from __future__ import annotations

from collections.abc import Callable
from functools import partial
from typing import TypeVar

import anyio
import anyio.to_thread

T = TypeVar("T")


class ThreadLimit:
    """A limited number of threads that run blocking calls."""

    def __init__(self, threads: int) -> None:
        self._limiter = anyio.CapacityLimiter(threads)

    async def ask(self, call: Callable[..., T], *args: object) -> T:
        """Run a blocking call in a thread of the pool. If all threads are busy, wait until one is free."""
        return await anyio.to_thread.run_sync(partial(call, *args), limiter=self._limiter)

    async def listen(self, call: Callable[..., T], *args: object) -> T:
        """Run a blocking call that changes nothing. If the request is cancelled, do not wait for the call's end."""
        task = partial(call, *args)
        return await anyio.to_thread.run_sync(task, limiter=self._limiter, abandon_on_cancel=True)
