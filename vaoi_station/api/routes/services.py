"""The objects that all routes use."""

from __future__ import annotations

import asyncio
from dataclasses import dataclass, field

from vaoi_station.api.event_hub import EventHub
from vaoi_station.api.limits import QueuedSeats, ThreadLimit
from vaoi_station.api.other_station import OtherStation
from vaoi_station.hermes.service import HermesService
from vaoi_station.push.publisher import Publisher
from vaoi_station.runs.control.coordinator import StationCoordinator

COMMAND_THREADS = 16
PICTURE_THREADS, PICTURES_OF_CALLER = 8, 6
"""Pictures that are made at the same time; those of one caller that are being made or have not been read yet."""
EXPLAINED_THREADS, ELSEWHERE_THREADS = 4, 4
SEARCH_THREADS, SEARCHES, SEARCHES_OF_CALLER = 2, 4, 2
"""Searches at a time (the database has more readers, which stay for others); searches and long lists, in all and of one
caller, that are made or not yet read. One reads up to 20,000 rows: in the threads of commands, many of them would let
disarming and matrices wait."""


@dataclass(frozen=True)
class Services:
    """The coordinator, and the thread pools in which routes call it, so that they do not block the event loop."""

    coordinator: StationCoordinator
    hub: EventHub
    publishers: tuple[Publisher, ...] = ()
    line: HermesService | None = None
    """The neighbours in the line; None if they do not speak Hermes."""
    other_station: OtherStation | None = None
    """The station that films the other side of the boards; None: boards are of this one alone."""
    commands: ThreadLimit = field(default_factory=lambda: ThreadLimit(COMMAND_THREADS))
    pictures: ThreadLimit = field(default_factory=lambda: ThreadLimit(PICTURE_THREADS))
    picture_seats: QueuedSeats = field(
        default_factory=lambda: QueuedSeats("pictures", PICTURE_THREADS, PICTURES_OF_CALLER)
    )
    """For frames and temporary images: a seat is the right to one picture in memory."""
    elsewhere: ThreadLimit = field(default_factory=lambda: ThreadLimit(ELSEWHERE_THREADS))
    """For questions to the other station, which may be silent: they must not take the threads of commands."""
    explained: ThreadLimit = field(default_factory=lambda: ThreadLimit(EXPLAINED_THREADS))
    """For calls that may wait for the complete result of a run."""
    searching: ThreadLimit = field(default_factory=lambda: ThreadLimit(SEARCH_THREADS))
    search_seats: QueuedSeats = field(
        default_factory=lambda: QueuedSeats("searches and long lists", SEARCHES, SEARCHES_OF_CALLER)
    )
    changing: asyncio.Lock = field(default_factory=asyncio.Lock)
    """Held while a board type is changed: between the check of If-Match and the change no other caller may do so."""
