"""The events that the worker pool reports."""

from __future__ import annotations

from typing import Protocol

from vaoi_station.runs.workers.jobs import Job, Reply


class WorkerEvents(Protocol):
    """Receiver of the pool's events: every method returns at once and may be called from any thread."""

    def worker_reply(self, job: Job, answer: Reply) -> None:
        """Report the outcome of a job; called once for each submitted job.

        After a successful `ConcludeJob` with a check it is called once more, with the `CheckJob`.
        """

    def worker_ended(self, description: str) -> None:
        """Report that a worker process has ended unexpectedly; the pool restarts it."""

    def workers_ready(self) -> None:
        """Report that the last worker has become ready; repeated after every restart."""
