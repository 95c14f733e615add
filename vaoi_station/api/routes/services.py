"""The objects that all routes use."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field

from vaoi_station.api.event_hub import COMMAND_THREADS, EventHub
from vaoi_station.api.limits import PICTURE_THREADS, QueuedSeats, Searches, ThreadLimit, picture_seats
from vaoi_station.push.publisher import Publisher
from vaoi_station.runs.control.coordinator import StationCoordinator


@dataclass(frozen=True)
class Services:
    """The coordinator, and the thread pools in which routes call it, so that they do not block the event loop."""

    coordinator: StationCoordinator
    hub: EventHub
    publisher: Publisher | None = None
    commands: ThreadLimit = field(default_factory=lambda: ThreadLimit(COMMAND_THREADS))
    pictures: ThreadLimit = field(default_factory=lambda: ThreadLimit(PICTURE_THREADS))
    picture_seats: QueuedSeats = field(default_factory=picture_seats)
    searches: Searches = field(default_factory=Searches)
    changing: asyncio.Lock = field(default_factory=asyncio.Lock)
    """Held while a board type is changed: between the check of If-Match and the change no other caller may do so."""
