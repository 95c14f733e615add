"""The stream of a batch: parts are cut by several workers at a time, and passed on as they become ready.

At most `PARTS_AHEAD` parts are being cut or wait for the reader, so that memory does not grow with the batch. The next
part is requested only when the reader has taken one.
"""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable

from vaoi_station.api.callers.thread_limit import ThreadLimit
from vaoi_station.errors import InternalError, VaoiError
from vaoi_station.runs.batches.batch_job import CutPart
from vaoi_station.runs.batches.batches import Batch, BatchPart
from vaoi_station.runs.batches.containers import ContainerWriter

PARTS_AHEAD = 4
"""Number of parts of a batch that are being cut or wait for its reader."""
_log = logging.getLogger(__name__)

Done = tuple[CutPart, BatchPart | None]
"""A part that was cut, and what remains of it."""
Cut = Callable[[BatchPart], Awaitable[Done]]
"""Function that has a part cut, and returns what remains of it."""


class CutThreads:
    """A limited number of threads that cut parts. A part whose reader has gone keeps its thread until it is cut."""

    def __init__(self, threads: int) -> None:
        self._places, self._limit = asyncio.Semaphore(threads), ThreadLimit(threads)

    async def ask(self, cut: Callable[[Batch, BatchPart], Done], batch: Batch, part: BatchPart) -> Done:
        """Have a part cut in a thread. A cancelled call gives up its turn, or leaves the thread to its end."""
        await self._places.acquire()
        work = asyncio.ensure_future(self._limit.ask(cut, batch, part))
        work.add_done_callback(self._ended)
        return await asyncio.shield(work)

    def _ended(self, work: asyncio.Task[Done]) -> None:
        self._places.release()
        if not work.cancelled():
            work.exception()  # read, because no caller may wait for it any more


async def stream(batch: Batch, cut: Cut) -> AsyncIterator[bytes]:
    """Yield the bytes of a batch: its head, its parts in order of readiness, and its end.

    An error ends the batch with a last file that states it, because the status 200 is sent already.
    """
    writer = ContainerWriter(batch.request.container, batch.modified_s)
    yield writer.add(batch.pack(batch.head))
    images = refused = 0
    error: VaoiError | None = None
    waiting, tasks = deque(batch.parts()), set[asyncio.Future[Done]]()
    try:
        while (waiting or tasks) and error is None:
            while waiting and len(tasks) < PARTS_AHEAD:
                tasks.add(asyncio.ensure_future(cut(waiting.popleft())))
            done, tasks = await asyncio.wait(tasks, return_when=asyncio.FIRST_COMPLETED)
            for task in done:
                try:
                    found, rest = task.result()
                except VaoiError as fault:
                    error = fault
                    continue
                if rest is not None:
                    waiting.appendleft(rest)
                images, refused = images + found.images, refused + found.refused
                yield writer.add(found.packed)
    except Exception:  # noqa: BLE001  the status is sent, so that only the last file can state an error
        _log.exception("a batch of run %s failed", batch.run)
        error = InternalError("The batch ended by an error of the station; the log has the cause.")
    finally:
        for task in tasks:
            task.cancel()
    yield writer.add(batch.pack(batch.end(images, refused, error)))
    yield writer.end()
