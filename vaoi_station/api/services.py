"""What the routes work with."""

from __future__ import annotations

from dataclasses import dataclass, field

from vaoi_station.api.waiting import COMMAND_THREADS, PICTURE_THREADS, Hub, Threads
from vaoi_station.runs.facade import Conductor


@dataclass(frozen=True)
class Services:
    """The conductor, and the ways to call it without blocking the event loop."""

    conductor: Conductor
    hub: Hub
    commands: Threads = field(default_factory=lambda: Threads(COMMAND_THREADS))
    pictures: Threads = field(default_factory=lambda: Threads(PICTURE_THREADS))
