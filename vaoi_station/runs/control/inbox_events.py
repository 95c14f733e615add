"""Receiver of the processes' reports, which posts them to the coordinator's inbox."""

from __future__ import annotations

import time

from vaoi_station.acquisition.process.messages import Report
from vaoi_station.runs.control.core import Core
from vaoi_station.runs.control.inbox import Inbox
from vaoi_station.runs.pictures.picture_requests import PictureRequests
from vaoi_station.runs.workers.jobs import Job, PictureJob, Reply


class InboxEvents:
    """Implementation of `StationEvents` that turns every report into one message to the coordinator's thread.

    Only replies to render jobs go directly to the callers that wait for a picture.
    """

    def __init__(self, inbox: Inbox, core: Core, pictures: PictureRequests) -> None:
        self._inbox, self._core, self._pictures = inbox, core, pictures

    def acquisition_message(self, message: Report) -> None:
        """Pass a message of the acquisition process to the coordinator."""
        self._inbox.post(self._core.acquisition_message, message)

    def acquisition_ended(self, description: str) -> None:
        """Let the coordinator conclude the runs that were being filmed when the acquisition process ended."""
        self._inbox.post(self._core.acquisition_ended, description)

    def worker_reply(self, job: Job, reply: Reply) -> None:
        """Pass a worker's reply, with the time of its arrival, to the coordinator."""
        if isinstance(job, PictureJob):
            # A picture changes no state, and its caller waits in another thread. So the reply need not wait in the
            # inbox behind messages about frames.
            self._pictures.complete(job, reply)
        else:
            self._inbox.post(self._core.worker_reply, job, reply, time.monotonic())

    def worker_ended(self, description: str) -> None:
        """Let the coordinator publish that a worker process has ended."""
        self._inbox.post(self._core.worker_ended, description)

    def workers_ready(self) -> None:
        """Let the coordinator publish that all workers are ready."""
        self._inbox.post(self._core.workers_ready)
