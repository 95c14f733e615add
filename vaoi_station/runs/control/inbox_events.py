"""Events of the processes, posted to the coordinator's inbox."""

from __future__ import annotations

import time

from vaoi_station.acquisition.process.messages import Report
from vaoi_station.runs.control.core import Core
from vaoi_station.runs.control.inbox import Inbox
from vaoi_station.runs.control.pictures import PictureRequests
from vaoi_station.runs.workers.jobs import Job, RenderJob, Reply


class InboxEvents:
    """Implementation of `StationEvents`: every event becomes one message to the coordinator's thread."""

    def __init__(self, inbox: Inbox, core: Core, pictures: PictureRequests) -> None:
        self._inbox, self._core, self._pictures = inbox, core, pictures

    def acquisition_message(self, message: Report) -> None:
        """Have the coordinator process a message of the acquisition process."""
        self._inbox.post(self._core.acquisition_message, message)

    def acquisition_ended(self, description: str) -> None:
        """Have the coordinator conclude what was filmed before the process ended."""
        self._inbox.post(self._core.acquisition_ended, description)

    def worker_reply(self, job: Job, reply: Reply) -> None:
        """Have the coordinator process a reply, with the time at which it arrived."""
        if isinstance(job, RenderJob):
            # The caller waits in its own thread and changes no state: its picture does not queue behind frames.
            self._pictures.complete(job, reply)
        else:
            self._inbox.post(self._core.worker_reply, job, reply, time.monotonic())

    def worker_ended(self, description: str) -> None:
        """Have the coordinator log the end of a worker."""
        self._inbox.post(self._core.worker_ended, description)

    def workers_ready(self) -> None:
        """Have the coordinator log that all workers are ready."""
        self._inbox.post(self._core.workers_ready)
