"""One listener that wakes all requests that wait for events. Long polls and event streams hold no thread."""

from __future__ import annotations

import asyncio
import logging
import time
from collections.abc import AsyncIterator
from contextlib import asynccontextmanager, suppress

from vaoi_station.api.limits import Seats, ThreadLimit
from vaoi_station.errors import StateError
from vaoi_station.runs.control.coordinator import StationCoordinator
from vaoi_station.runs.states.schemas import EventRecord
from vaoi_station.runs.states.tables import StationState

log = logging.getLogger(__name__)

MAX_WAITING, MAX_POLLS_OF_CALLER, MAX_STREAMS_OF_CALLER = 128, 32, 24
"""Limits of simultaneous long polls, and of simultaneous event streams, in all and of one caller."""
EVENTS_AT_ONCE = 100
"""Number of events that are read at once: a stream that is not read keeps no more in memory."""
RETRY_S = 1.0
"""Pause after a read of events that has failed, s."""
LISTEN_S = 1.0
"""Longest time the listener waits for an event. A stop that publishes no event takes effect within this time."""


class EventHub:
    """Wakes all requests that wait for events. One thread serves any number of waiting requests."""

    def __init__(self, coordinator: StationCoordinator) -> None:
        self._coordinator = coordinator
        self._readers, self._listener = ThreadLimit(4), ThreadLimit(1)
        self._wakeup = asyncio.Event()
        self.newest = 0
        """Number of the newest event of the log."""
        # These limits are separate, so that a caller with too many streams can still wait for its next run.
        self.polls = Seats("long polls", MAX_WAITING, MAX_POLLS_OF_CALLER)
        self.streams = Seats("event streams", MAX_WAITING, MAX_STREAMS_OF_CALLER)
        self.closed = False

    @asynccontextmanager
    async def listening(self) -> AsyncIterator[None]:
        """Listen for new events, and wake waiting requests, while the application runs."""
        self._wakeup = asyncio.Event()
        self.newest = (await self._readers.ask(self._coordinator.snapshot)).last_event
        task = asyncio.create_task(self._listen())
        try:
            yield
        finally:
            self.close()
            task.cancel()
            with suppress(asyncio.CancelledError):
                await task

    def close(self) -> None:
        """End all event streams and long polls. Must be called from the event loop."""
        self.closed = True
        self._wakeup.set()

    async def closing(self) -> None:
        """Wait until the hub is closed: the station stops, or no further event will come."""
        while not self.closed:
            await self._wakeup.wait()

    @property
    def waiting(self) -> int:
        """Number of long polls and event streams that wait at present."""
        return self.polls.taken + self.streams.taken

    async def events(self, after: int, timeout_s: float) -> tuple[EventRecord, ...]:
        """Wait for events numbered above `after`. Return the oldest ones; none on time-out or after `close`."""
        with suppress(TimeoutError):
            async with asyncio.timeout(max(0.0, timeout_s)):
                while self.newest <= after and not self.closed:
                    await self._wakeup.wait()
        if self.newest <= after:
            return ()
        return await self._readers.ask(self._coordinator.events, after, 0.0, EVENTS_AT_ONCE)

    async def _listen(self) -> None:
        while not self.closed:
            asked = time.monotonic()
            try:
                records = await self._listener.listen(self._coordinator.events, self.newest, LISTEN_S)
            except StateError:
                self.close()  # The log is closed, because the station stops.
                return
            except Exception as error:  # noqa: BLE001  all waits depend on this task: it goes on, as after a lack of threads
                log.error("reading of events failed; it is tried again: %s", error)
                with suppress(TimeoutError):
                    await asyncio.wait_for(self.closing(), RETRY_S)
                continue
            if records:
                self.newest = records[-1].number
                # Setting the old asyncio.Event wakes the tasks that wait now. Later tasks need one that is not set.
                self._wakeup.set()
                self._wakeup = asyncio.Event()
                if any(r.kind == "station" and r.state == StationState.STOPPING for r in records):
                    self.close()
            elif time.monotonic() - asked < LISTEN_S / 2:
                # The call returned early without an event: the log is closed, and no further event will come.
                self.close()
