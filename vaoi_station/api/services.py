"""The objects that all routes use."""

from __future__ import annotations

from collections.abc import AsyncIterator
from dataclasses import dataclass, field

from fastapi import Request

from vaoi_station.api.callers.caller import caller_of
from vaoi_station.api.callers.seats import QueuedSeats
from vaoi_station.api.event_hub import COMMAND_THREADS, PICTURE_THREADS, EventHub, ThreadLimit
from vaoi_station.runs.control.coordinator import StationCoordinator

PICTURES_OF_CALLER = 6
"""Pictures that are made for one caller, or that it has not yet read, at a time."""
PICTURES_WAITING = 24
PICTURE_WAIT_S = 20.0


@dataclass(frozen=True)
class Services:
    """The coordinator, and the thread pools in which routes call it, so that they do not block the event loop."""

    coordinator: StationCoordinator
    hub: EventHub
    commands: ThreadLimit = field(default_factory=lambda: ThreadLimit(COMMAND_THREADS))
    pictures: ThreadLimit = field(default_factory=lambda: ThreadLimit(PICTURE_THREADS))
    documents: ThreadLimit = field(default_factory=lambda: ThreadLimit(1))
    """A thread that parses large documents. One at a time, because parsing holds the interpreter's lock."""
    picture_seats: QueuedSeats = field(
        default_factory=lambda: QueuedSeats(
            "pictures", PICTURE_THREADS, PICTURES_OF_CALLER, PICTURES_WAITING, PICTURE_WAIT_S
        )
    )

    async def seat_for_picture(self, request: Request) -> AsyncIterator[None]:
        """Hold a seat until the caller has read its picture; a dependency of routes."""
        # A dependency ends after the answer was sent. So the memory for pictures that are not read is limited.
        async with self.picture_seats.take(caller_of(request).name):
            yield
