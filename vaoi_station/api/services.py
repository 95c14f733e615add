"""What the routes work with."""

from __future__ import annotations

from dataclasses import dataclass, field

from vaoi_station.api.waiting import COMMAND_THREADS, PICTURE_THREADS, Hub, Threads
from vaoi_station.runs.control.facade import Coordinator


@dataclass(frozen=True)
class Services:
    """The coordinator, and the ways to call it without blocking the event loop."""

    coordinator: Coordinator
    hub: Hub
    commands: Threads = field(default_factory=lambda: Threads(COMMAND_THREADS))
    pictures: Threads = field(default_factory=lambda: Threads(PICTURE_THREADS))
