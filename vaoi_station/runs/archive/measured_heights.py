"""Heights of the components of finished runs: measured by workers after each run or on request, and stored.

After a run, one thread has them measured, in slices of the lowest priority. It holds no lease meanwhile: if the frames
are needed for the next board before it has finished, the run gets no heights.
"""

from __future__ import annotations

import json
import logging
import threading
from collections.abc import Callable
from contextlib import AbstractContextManager
from pathlib import Path
from typing import Any

from vaoi_station.errors import BusyError, GoneError, NotFoundError, StateError, VaoiError
from vaoi_station.heights.estimates import open_places
from vaoi_station.model import RecordingHead
from vaoi_station.photometry import FlatFields
from vaoi_station.runs.archive.event_log import EventLog
from vaoi_station.runs.archive.finished_runs import Archive, FinishedRun
from vaoi_station.runs.archive.kept_documents import KeptDocuments
from vaoi_station.runs.run.memory import Bay
from vaoi_station.runs.workers.jobs import PictureJob, Priority
from vaoi_station.runs.workers.picture_jobs import CombineHeightsJob, HeightsJob
from vaoi_station.supervised_queue import SupervisedQueue

_log = logging.getLogger(__name__)

_KEPT = 64
"""Number of runs whose heights are kept in memory."""
_MOST_WAITING = 8
"""Largest number of runs that wait for their heights; the oldest ones then get none."""
_SLICE_PARTS = 48
"""Number of components in the message of one slice: more than a worker measures in one slice."""


class MeasuredHeights:
    """Has heights measured by workers, and stores them. Methods may be called from any thread."""

    def __init__(
        self,
        archive: Archive,
        lease: Callable[[str, str], AbstractContextManager[Bay]],
        render: Callable[[PictureJob, str], Any],
        bay_of: Callable[[str], Bay],
        events: EventLog,
        flat_fields: Path | None = None,
    ) -> None:
        """Store the parts.

        Args:
            archive: the finished runs, and the stored heights.
            lease: keeps the frames of a run in memory in a `with` block; arguments are the run and the purpose.
            render: has a worker perform a job with this name in messages, and returns the reply's value.
            bay_of: returns the bay of a run without a lease.
            events: the event log.
            flat_fields: directory of the station's flat fields.
        """
        self._archive, self._lease, self._render, self._bay_of = archive, lease, render, bay_of
        self._events, self._flat_fields = events, flat_fields
        self._documents = KeptDocuments(archive.store.heights, _KEPT)
        self._lock = threading.Lock()
        """Held during a measurement, which may wait for minutes behind later boards."""
        self.queue = SupervisedQueue(self._measure_after, "heights", _MOST_WAITING)
        """The runs whose heights are to be measured after their end; started and stopped by the owner."""

    def document(self, run: str) -> bytes:
        """Return the heights of a run's components as JSON.

        Raises:
            NotFoundError: the run is unknown or has no result.
            StateError: the run has no CAD mapping, or its calibration no working distance.
            GoneError: the frames are no longer in memory, and the heights were not measured while they were.
        """
        if (found := self._documents.get(run)) is not None:
            return found
        with self._lock:
            # A second request for the same run finds the heights of the first.
            if (found := self._documents.get(run)) is not None:
                return found
            finished = _checked(self._archive.get(run))
            with self._lease(run, "heights of components") as bay:
                return self._measured(finished, bay, Priority.RENDER)

    def known(self, run: str) -> dict[str, tuple[float, float]] | None:
        """Return the measured heights of a run and their standard deviations, mm, by address; None without any.

        It waits for no measurement.
        """
        if (found := self._documents.get(run)) is None:
            return None
        entries = json.loads(found)["heights"]
        return {ref: (e["height_mm"], e["sigma_mm"]) for ref, e in entries.items() if "height_mm" in e}

    def _measured(self, finished: FinishedRun, bay: Bay, priority: Priority) -> bytes:
        """Have the heights of all components measured, slice by slice, combined and stored."""
        run, board_type, head, stitch = finished.detail.id, finished.board_type, finished.head, finished.lean
        lights, fields = (head.lights or ()) if head is not None else (), self._fitting_fields(head)
        parts: dict[str, Any] = {}
        while len(parts) < len(board_type.components) and not self.queue.stopping:
            some = board_type.components[len(parts) : len(parts) + _SLICE_PARTS]
            slim = board_type.model_copy(update={"components": some})
            job = HeightsJob(
                run, bay.number, bay.generation, slim, stitch, finished.cameras, lights, finished.slots, fields,
                priority=priority,
            )  # fmt: skip
            parts |= self._render(job, "heights")
        if self.queue.stopping:
            raise StateError("The station is stopping; the heights were not measured.")
        combine = CombineHeightsJob(run, bay.number, bay.generation, board_type, stitch, parts, priority=priority)
        content = self._documents.put(run, self._render(combine, "table of heights"))
        self._archive.store.save_heights(run, content.decode())
        return content

    def _fitting_fields(self, head: RecordingHead | None) -> Path | None:
        """Return the directory of the flat fields if they are those of the run's cameras and lights, else None.

        Heights can be measured without them. That they do not fit is a warning of each run and of `vaoi doctor`.
        """
        if self._flat_fields is None or head is None:
            return None
        try:
            FlatFields.peek(self._flat_fields).check_head(head)
        except VaoiError:
            return None
        return self._flat_fields

    def _measure_after(self, run: str) -> None:
        """Measure the heights of a run that has just ended, if it can have any."""
        try:
            finished = _checked(self._archive.get(run))
            # Callers who request the heights meanwhile wait for these.
            with self._lock:
                if self._documents.get(run) is None:
                    self._measured(finished, self._bay_of(run), Priority.HEIGHTS)
        except (StateError, GoneError, NotFoundError, BusyError):
            return  # It has no result, its frames were needed, or the station stops.
        except Exception as fault:  # noqa: BLE001  the thread must go on: later runs need it
            _log.warning("heights of run %s failed", run, exc_info=True)
            self._events.add("trouble", f"Heights were not measured: {fault}", run=run, code="heights-not-measured")


def _checked(finished: FinishedRun) -> FinishedRun:
    """Return a run that can have heights; raise StateError or NotFoundError for another, before a worker is asked."""
    open_places(finished.board_type, finished.lean, finished.cameras)
    return finished
