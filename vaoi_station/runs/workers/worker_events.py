"""The interface by which the worker pool reports replies and the state of its workers."""

from __future__ import annotations

from typing import Protocol

from vaoi_station.runs.workers.jobs import Job, Reply


class WorkerEvents(Protocol):
    """Receiver of the pool's reports. Every method returns at once and may be called from any thread."""

    def worker_reply(self, job: Job, answer: Reply) -> None:
        """Report the outcome of a job. The pool calls this method once for each submitted job.

        After a successful `ConcludeJob` with a check, the pool calls it once more, with the `CheckJob`.
        """

    def worker_ended(self, description: str) -> None:
        """Report that a worker process has ended unexpectedly. The pool restarts it."""

    def workers_ready(self) -> None:
        """Report that all workers are ready; reported again when a restarted worker has become ready."""
