"""Heights of the components of finished runs, which a worker measures when they are first requested."""

from __future__ import annotations

import threading
from collections import OrderedDict
from collections.abc import Callable
from contextlib import AbstractContextManager
from typing import Any

from vaoi_station.heights.estimates import open_places
from vaoi_station.runs.archive.finished_runs import Archive
from vaoi_station.runs.run.memory import Bay
from vaoi_station.runs.workers.heights_job import HeightsJob
from vaoi_station.runs.workers.jobs import PictureJob

_KEPT = 64
"""Number of runs whose heights are kept in memory."""


class MeasuredHeights:
    """Has heights measured by workers, and keeps those of the latest runs. Methods may be called from any thread."""

    def __init__(
        self,
        archive: Archive,
        lease: Callable[[str, str], AbstractContextManager[Bay]],
        render: Callable[[PictureJob, str], Any],
    ) -> None:
        """Store the archive of runs and two functions.

        Args:
            archive: the finished runs.
            lease: keeps the frames of a run in memory in a `with` block; arguments are the run and the purpose.
            render: has a worker perform a job with this name in messages, and returns the reply's value.
        """
        self._archive, self._lease, self._render = archive, lease, render
        self._known: OrderedDict[str, bytes] = OrderedDict()
        self._lock = threading.Lock()

    def document(self, run: str) -> bytes:
        """Return the heights of a run's components as JSON.

        Raises:
            NotFoundError: the run is unknown or has no result.
            StateError: the run has no CAD mapping, or its calibration no working distance.
            GoneError: the frames are no longer in memory, and the heights were not measured while they were.
        """
        # One caller at a time: a second request for the same run finds the heights of the first.
        with self._lock:
            if run not in self._known:
                self._known[run] = self._measured(run)
                if len(self._known) > _KEPT:
                    self._known.popitem(last=False)
            return self._known[run]

    def _measured(self, run: str) -> bytes:
        finished = self._archive.get(run)
        stitch, head = finished.stitch or finished.result, finished.head
        open_places(finished.board_type, stitch, finished.cameras)  # refuses before a worker is asked
        slots = {(f.camera, f.row): f.slot for f in finished.detail.frames if f.usable and f.slot is not None}
        lights = (head.lights or ()) if head is not None else ()
        with self._lease(run, "heights of components") as bay:
            job = HeightsJob(
                run, bay.number, bay.generation, finished.board_type, stitch, finished.cameras, lights, slots
            )
            content: bytes = self._render(job, "heights")
        return content
