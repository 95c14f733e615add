"""Waiting without holding threads: blocking calls in bounded pools, and one listener for all who wait.

Two pools: commands and look-ups, and pictures; a burst of pictures must not delay arming. Long polls and
event streams hold no thread at all: one listener waits for the next event and wakes everybody.
"""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager, suppress
from functools import partial
from typing import TypeVar

import anyio
import anyio.to_thread

from vaoi_station.errors import BusyError, VaoiError
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.runs.states.schemas import EventRecord
from vaoi_station.runs.states.tables import StationState

T = TypeVar("T")
log = logging.getLogger(__name__)

COMMAND_THREADS = 16
PICTURE_THREADS = 8
MAX_WAITING = 256
"""Long polls and event streams at once."""
LISTEN_S = 1.0
"""Longest wait of the listener, and with it the delay of a stop that no event announces."""


class ThreadLimit:
    """A bounded pool for blocking calls."""

    def __init__(self, threads: int) -> None:
        self._limiter = anyio.CapacityLimiter(threads)

    async def ask(self, call: Callable[..., T], *args: object) -> T:
        """Run a blocking call in a thread; waits for a free one."""
        return await anyio.to_thread.run_sync(partial(call, *args), limiter=self._limiter)

    async def listen(self, call: Callable[..., T], *args: object) -> T:
        """The same for calls that change nothing: who asked may go away, and the thread ends by itself."""
        task = partial(call, *args)
        return await anyio.to_thread.run_sync(task, limiter=self._limiter, abandon_on_cancel=True)


class EventHub:
    """Wakes everybody who waits for events; one thread, however many wait."""

    def __init__(self, coordinator: StationCoordinator) -> None:
        self._coordinator = coordinator
        self._readers = ThreadLimit(4)
        self._listener = ThreadLimit(1)
        self._news = asyncio.Event()
        self._newest = 0
        self.waiting = 0
        """Long polls and streams at this moment."""
        self.closed = False

    @asynccontextmanager
    async def listening(self) -> AsyncIterator[None]:
        """Listen for events as long as the application lives."""
        self._news = asyncio.Event()
        self._newest = (await self._readers.ask(self._coordinator.snapshot)).last_event
        task = asyncio.create_task(self._listen())
        try:
            yield
        finally:
            self.close()
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task

    def close(self) -> None:
        """End every stream and long poll; call from the event loop."""
        self.closed = True
        self._news.set()

    @asynccontextmanager
    async def place(self) -> AsyncIterator[None]:
        """Room for one who waits; BusyError when too many do."""
        if self.waiting >= MAX_WAITING:
            raise BusyError(f"{self.waiting} callers are waiting for news, which is the limit.")
        self.waiting += 1
        try:
            yield
        finally:
            self.waiting -= 1

    async def events(self, after: int, timeout_s: float) -> tuple[EventRecord, ...]:
        """Events numbered above `after`, oldest first; waits for one, and is empty on time-out or at the end."""
        if await self.changed(after, timeout_s):
            return await self._readers.ask(self._coordinator.events, after, 0.0)
        return ()

    async def changed(self, after: int, timeout_s: float) -> bool:
        """Wait until there is an event numbered above `after`; False on time-out or at the end."""
        until = time.monotonic() + timeout_s
        while self._newest <= after and not self.closed:
            left_s = until - time.monotonic()
            if left_s <= 0:
                return False
            try:
                await asyncio.wait_for(self._news.wait(), left_s)
            except TimeoutError:
                return False
        return self._newest > after

    @property
    def newest(self) -> int:
        """Number of the newest event."""
        return self._newest

    async def _listen(self) -> None:
        while not self.closed:
            asked = time.monotonic()
            try:
                records = await self._listener.listen(self._coordinator.events, self._newest, LISTEN_S)
            except VaoiError as error:
                log.error("events cannot be read any more: %s", error)
                self.close()
                return
            if records:
                self._newest = records[-1].number
                self._news.set()
                self._news = asyncio.Event()
                if any(r.kind == "station" and r.state == StationState.STOPPING for r in records):
                    self.close()
            elif time.monotonic() - asked < LISTEN_S / 2:
                self.close()  # a log that does not wait any more is closed: nothing will come
