"""Requests for pictures that workers make, matched with the callers that wait for them."""

from __future__ import annotations

import itertools
import threading
from collections.abc import Callable
from concurrent.futures import Future
from dataclasses import replace
from typing import Any

from vaoi_station.errors import DeviceError
from vaoi_station.runs.workers.jobs import PictureJob, Reply

RENDER_LIMIT_S = 60.0
"""Longest wait of a caller for a rendered picture."""


class PictureRequests:
    """Sends render jobs to the workers, and passes each reply to the caller that waits for it.

    Jobs and replies are matched by a request number. Methods may be called from any thread.
    """

    def __init__(self, submit: Callable[[PictureJob], None]) -> None:
        """Begin without requests; `submit` queues a job for a worker."""
        self._submit = submit
        self._numbers = itertools.count(1)
        self._lock = threading.Lock()
        self._pending: dict[int, Future[Reply]] = {}

    def render(self, job: PictureJob, name: str) -> Any:
        """Submit a picture job, wait for its reply, and return its value: of a render job the encoded picture.

        Args:
            job: the job; this method sets its request number.
            name: name of the picture for the message of a refusal.

        Raises:
            DeviceError: no worker rendered the picture within `RENDER_LIMIT_S`.
            VaoiError: the worker refused the job.
        """
        # Two callers may request the same picture at the same time: only the number distinguishes their jobs.
        numbered = replace(job, request=next(self._numbers))  # type: ignore[type-var]  # all of them are dataclasses
        pending: Future[Reply] = Future()
        with self._lock:
            self._pending[numbered.request] = pending
        try:
            self._submit(numbered)
            reply = pending.result(RENDER_LIMIT_S)
        except TimeoutError:
            raise DeviceError(
                f"No worker rendered image {name} within {RENDER_LIMIT_S:.0f} s.",
                action="Check the state of the workers.",
            ) from None
        finally:
            with self._lock:
                del self._pending[numbered.request]
        if reply.error is not None:
            raise reply.error
        return reply.value

    def complete(self, job: PictureJob, reply: Reply) -> None:
        """Pass a worker's reply to the caller that waits for it. If the caller no longer waits, drop the reply."""
        with self._lock:
            pending = self._pending.get(job.request)
            if pending is not None:
                pending.set_result(reply)
