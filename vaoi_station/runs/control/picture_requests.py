"""Pictures that callers wait for while a worker renders them."""

from __future__ import annotations

import itertools
import threading
from concurrent.futures import Future
from dataclasses import replace

from vaoi_station.errors import DeviceError
from vaoi_station.runs.control.active_runs import Workers
from vaoi_station.runs.workers.jobs import RenderJob, Reply

RENDER_LIMIT_S = 60.0
"""Time after which a caller no longer waits for its picture."""


class PictureRequests:
    """Requests for pictures, matched with the workers' answers by their number; usable from any thread."""

    def __init__(self, workers: Workers) -> None:
        self._workers = workers
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._pending: dict[int, Future[Reply]] = {}

    def render(self, job: RenderJob, name: str) -> bytes:
        """Submit a job and wait for the encoded picture.

        Args:
            job: without a request number.
            name: of the picture in a refusal.

        Raises:
            DeviceError: no worker rendered it in time.
            VaoiError: the worker's refusal.
        """
        # Two callers may want the same picture: only the number distinguishes their jobs.
        numbered = replace(job, request=next(self._numbers))
        pending: Future[Reply] = Future()
        with self._lock:
            self._pending[numbered.request] = pending
        try:
            self._workers.submit(numbered)
            answer = pending.result(RENDER_LIMIT_S)
        except TimeoutError:
            raise DeviceError(
                f"No worker rendered image {name} within {RENDER_LIMIT_S:.0f} s.",
                action="Check the state of the workers.",
            ) from None
        finally:
            with self._lock:
                del self._pending[numbered.request]
        if answer.error is not None:
            raise answer.error
        content: bytes = answer.value
        return content

    def complete(self, job: RenderJob, answer: Reply) -> None:
        """Pass an answer to the caller that waits for it; ignored if the caller has given up."""
        with self._lock:
            pending = self._pending.get(job.request)
            if pending is not None:
                pending.set_result(answer)
