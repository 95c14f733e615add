"""Identities of runs: their codes are read by workers after each run, stored, and compared with ids from elsewhere.

One thread has the codes read after the result of a run, in slices, so that no result waits for them. It holds no lease
meanwhile: if the frames are needed for the next board before it has finished, the codes were not read.
"""

from __future__ import annotations

import contextlib
import logging
import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from typing import Any

from vaoi_station.errors import BusyError, DeviceError, GoneError, NotFoundError, StateError, VaoiError
from vaoi_station.identity.comparison import compare
from vaoi_station.model import BoardReading
from vaoi_station.model.board_identity import IdentityDocument, ReportedId
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive, FinishedRun
from vaoi_station.runs.run.memory import Bay
from vaoi_station.runs.states.schemas import RunDetail
from vaoi_station.runs.workers.jobs import PictureJob
from vaoi_station.runs.workers.picture_jobs import IdentityJob, IdentitySlice
from vaoi_station.supervised_queue import SupervisedQueue

_log = logging.getLogger(__name__)

BUDGET_S = 3.0
"""Time of workers after which no further pictures of a run are tried."""
_MOST_WAITING = 8
"""Largest number of runs that wait for their codes to be read; the oldest ones are then not read."""


class ReadIdentities:
    """Has codes read by workers, stores and compares ids. Methods may be called from any thread."""

    def __init__(
        self,
        archive: Archive,
        render: Callable[[PictureJob, str], Any],
        bay_of: Callable[[str], Bay],
        events: EventLog,
    ) -> None:
        """Store the parts. `render` has a worker perform a job, `bay_of` returns the bay of a run without a lease."""
        self._archive, self._render, self._bay_of, self._events = archive, render, bay_of, events
        self.on_changed: Callable[[str], None] = lambda _run: None
        """Function that is called with a run whose identity was decided, or has changed. It must return at once."""
        self._earlier: list[str] = []
        """Runs whose codes were still to be read when the station ended."""
        self._changing = threading.Lock()
        """Held while a stored identity is changed, so that no report is lost."""
        self.queue = SupervisedQueue(self._read_next, "identity", _MOST_WAITING, begin=self._close_earlier)
        """The runs whose codes are to be read; stopped by the owner."""

    def start(self) -> None:
        """Start the thread that has codes read after runs."""
        with contextlib.suppress(DeviceError):  # A database that cannot be read does not keep the station from filming.
            self._earlier = self._archive.identities.pending()
        self.queue.start()

    def finished(self, detail: RunDetail) -> None:
        """Have the codes of a run read that has just ended, if its board type has any; it returns at once."""
        if detail.identity is not None and (left_out := self.queue.put(detail.id)) is not None:
            self._not_read(left_out)

    def document(self, run: str) -> IdentityDocument:
        """Return the identity of a run; raises the errors of `Archive.get`."""
        finished = self._archive.get(run)
        return finished.identity or compare(finished.board_type.identity, None, finished.detail.board_id)

    def report(self, run: str, reported: ReportedId) -> IdentityDocument:
        """Store the id that the next machine has read, compare it, and publish the result; return the identity."""
        with self._changing:
            before = self.document(run)
            if before.state == "pending":
                raise StateError(
                    f"The codes of run {run} are being read.",
                    action="Wait for it by runs/{id}/identity?timeout=5, then report again.",
                    code="identity-pending",
                )
            read = None
            if before.read:
                read = BoardReading(codes=before.codes, unread_places=before.unread_places, complete=before.complete)
            return self._keep(run, _compared(self._archive.get(run), read, reported))

    def _not_read(self, run: str) -> None:
        """Record that the codes of a run were not read, if it waits for that."""
        with self._changing:
            before = self._archive.get(run).identity
            if before is not None and before.state == "pending":
                self._keep(run, before.without_reading())

    def _keep(self, run: str, document: IdentityDocument) -> IdentityDocument:
        """Store an identity, then publish it."""
        self._archive.identify(run, document).add_done_callback(lambda saved: _log_failure(run, saved))
        self.on_changed(run)
        message = "; ".join(reason.message for reason in document.reasons) or _sentence(document)
        code, action = (document.reasons[0].code, document.reasons[0].action) if document.reasons else ("", "")
        self._events.add("identity", message, state=document.state, run=run, code=code, action=action)
        return document

    def _read_next(self, run: str) -> None:
        """Have the codes of a run read, or record that they were not."""
        if not self._safely(self._read_after, run):
            self._safely(self._not_read, run)

    def _safely(self, step: Callable[[str], None], run: str) -> bool:
        """Perform a step, and return whether it succeeded; a fault is published."""
        try:
            step(run)
        except VaoiError as error:
            _log.info("codes of run %s: %s", run, error.message)  # It was forgotten, or the station stops.
        except Exception as fault:  # noqa: BLE001  the thread must go on: later runs need it
            _log.warning("codes of run %s were not read", run, exc_info=True)
            self._events.add("trouble", f"Codes were not read: {fault}", run=run, code="identity-not-read")
        else:
            return True
        return False

    def _close_earlier(self) -> None:
        """Record that codes were not read of the runs that waited for it when the station ended."""
        for run in self._earlier:
            self._safely(self._not_read, run)

    def _read_after(self, run: str) -> None:
        """Read the codes of a run that has just ended, compare its ids and store both."""
        finished = self._archive.get(run)
        reading = self._reading(finished)
        with self._changing:
            self._keep(run, _compared(finished, reading))

    def _reading(self, finished: FinishedRun) -> BoardReading | None:
        """Have the codes read, slice by slice; None if the run has no result, or its frames were needed."""
        run, spent_s, done = finished.detail.id, 0.0, None
        slim = finished.board_type.model_copy(update={"components": ()})
        if slim.outline is None:
            low, high = finished.board_type.extent()
            slim = slim.model_copy(update={"outline": (tuple(low.tolist()), tuple(high.tolist()))})
        try:
            if finished.lean.cad_matrix is None:
                return None
            bay = self._bay_of(run)
            job = IdentityJob(
                run, bay.number, bay.generation, slim, finished.lean, finished.cameras, finished.slots
            )  # fmt: skip
            while not self.queue.stopping:
                done = self._render(job, "codes")
                assert isinstance(done, IdentitySlice)
                spent_s += done.worker_s
                if done.progress.ended or spent_s > BUDGET_S:
                    return done.reading
                job = replace(job, progress=done.progress)
        except (GoneError, NotFoundError, BusyError):
            pass  # It has no result, or its frames were needed; what was read until then counts.
        if self.queue.stopping:
            raise StateError("The station is stopping; the codes were not read.")
        return done.reading if done is not None and done.reading.codes else None


def _compared(
    finished: FinishedRun, reading: BoardReading | None, reported: ReportedId | None = None
) -> IdentityDocument:
    """Compare the ids of a run's board; boards of a panel that are crossed out need no code."""
    detail = finished.detail
    return compare(finished.board_type.identity, reading, detail.board_id, reported, skipped=detail.skipped_boards)


def _log_failure(run: str, saved: Future[None]) -> None:
    if (fault := saved.exception()) is not None:
        _log.warning("identity of run %s could not be written: %s", run, fault)


def _sentence(document: IdentityDocument) -> str:
    """Return the message of the event of an identity without reasons."""
    if document.state == "not-read":
        return "The codes of the board were not read: the run has no CAD mapping, or its frames were needed."
    ids = [document.board_id] if document.board_id is not None else [*document.boards.values()]
    names = ", ".join(repr(name) for name in ids) or "no id"
    return f"Read {names}." if document.state == "not-compared" else f"Read {names}, as expected."
