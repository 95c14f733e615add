"""The one interface through which processes report events to the coordinator."""

from __future__ import annotations

from typing import Protocol

from vaoi_station.acquisition.process.messages import Report
from vaoi_station.runs.workers.worker_events import WorkerEvents


class StationEvents(WorkerEvents, Protocol):
    """Receiver of all events: every method returns at once and may be called from any thread.

    `inbox_events.InboxEvents` implements it. The pool receives the same object but sees only `WorkerEvents`,
    because the workers' room lies below this one.
    """

    def acquisition_message(self, message: Report) -> None:
        """Report a message of the acquisition process."""

    def acquisition_ended(self, description: str) -> None:
        """Report that the acquisition process has ended unexpectedly; it is restarted."""
