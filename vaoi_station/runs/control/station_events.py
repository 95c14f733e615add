"""The interface by which the workers and the acquisition process report to the coordinator."""

from __future__ import annotations

from typing import Protocol

from vaoi_station.acquisition.process.messages import Report
from vaoi_station.runs.workers.worker_events import WorkerEvents


class StationEvents(WorkerEvents, Protocol):
    """Receiver of all reports of the workers and the acquisition process.

    Every method returns at once and may be called from any thread.
    `inbox_events.InboxEvents` implements it. The worker pool uses only the methods of `WorkerEvents`, because
    `runs.workers` must not import `runs.control`.
    """

    def acquisition_message(self, message: Report) -> None:
        """Report a message from the acquisition process."""

    def acquisition_ended(self, description: str) -> None:
        """Report that the acquisition process has ended unexpectedly. `AcquisitionLink` restarts it."""
