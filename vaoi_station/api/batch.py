"""The route `runs/{id}/images`: the pictures of many components in one streamed answer.

Parts are cut by several workers at a time, and passed on as they become ready. At most `PARTS_AHEAD` parts are being
cut or wait for the reader, so that memory does not grow with the batch.
"""

from __future__ import annotations

import asyncio
import logging
from collections import deque
from collections.abc import AsyncIterator, Awaitable, Callable
from typing import Annotated, Literal
from urllib.parse import quote

from fastapi import APIRouter, Depends, Query, Request, Response
from fastapi.responses import StreamingResponse
from pydantic import BaseModel, Field

from vaoi_station.api.limits import QueuedSeats, ThreadLimit
from vaoi_station.api.middleware import is_head
from vaoi_station.api.parameters import RunId, file_reply, parse_box, rest_router
from vaoi_station.api.routes.pictures import Wanted, picture_query
from vaoi_station.api.routes.services import Services
from vaoi_station.errors import InternalError, VaoiError
from vaoi_station.runs.batches.batch_job import CutPart
from vaoi_station.runs.batches.batches import Batch, BatchPart, BatchRequest
from vaoi_station.runs.batches.containers import MEDIA_TYPES, ContainerName, ContainerWriter

PARTS_AHEAD = 4
"""Number of parts of a batch that are being cut or wait for its reader."""
BATCHES, BATCHES_OF_CALLER, BATCHES_WAITING, BATCH_WAIT_S = 4, 2, 4, 20.0
"""Limits of batches under way in total and of one caller, and of those of one caller that wait; longest wait, s."""
STREAMS = file_reply(
    "The files of the batch: run.json first, end.json last.", *(m.partition(";")[0] for m in MEDIA_TYPES.values())
)
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


class BatchQuery(BaseModel):
    """What a batch has; its pictures are as `ImageQuery` says."""

    component: list[Annotated[str, Field(min_length=1, max_length=200)]] | None = Field(
        default=None,
        description="Component, `ref` or `panel/ref`; give it once for each. Without it: all.",
        max_length=20_000,
    )
    within: str | None = Field(
        default=None,
        description="Only components whose centre is in this box: `x0,y0,x1,y1`, CAD.",
        max_length=200,
    )
    region: str | None = Field(
        default=None,
        description="This part of the board in place of components: `x0,y0,x1,y1`, CAD.",
        max_length=200,
    )
    hdr: bool = Field(default=False, description="One picture per component, merged of all its frames under one light.")
    format: Literal["png", "jpeg", "tiff", "npy", "raw"] = Field(
        default="png", description="Format of the pictures; `raw` is the pixels alone."
    )
    container: ContainerName = Field(default="multipart", description="How files are packed; none is compressed.")


async def _request(images: Wanted, query: Annotated[BatchQuery, Query()]) -> BatchRequest:
    return BatchRequest(
        components=tuple(query.component or ()),
        within=parse_box("within", query.within),
        region=parse_box("region", query.region),
        images=images,
        hdr=query.hdr,
        format=query.format,
        container=query.container,
    ).check()


def router(services: Services) -> APIRouter:
    """Create the route of batches."""
    routes = rest_router(prefix="/runs/{run}", tags=["pictures"])
    batches, threads = services.coordinator.batches, CutThreads(BATCHES * PARTS_AHEAD)
    seats = QueuedSeats("batches of pictures", BATCHES, BATCHES_OF_CALLER, BATCHES_WAITING, BATCH_WAIT_S)

    @routes.get("/images", response_class=Response, responses=STREAMS, dependencies=[Depends(seats.hold)])
    async def get_images(request: Request, run: RunId, wanted: Annotated[BatchRequest, Depends(_request)]) -> Response:
        """Return the pictures of all components, of some, or of a region, as files in one streamed answer.

        The first file, run.json, names the run. Components follow in the order in which they become ready, each as
        views.json (fields as in the list of views, with the file of each) and its pictures. The last file, end.json,
        states in `complete` whether all were sent. 410: the frames are no longer in memory, and no recording of the
        run is kept.
        """
        address = f"{quote(request.url.path.removesuffix('/images'))}/components"
        batch = await services.commands.ask(batches.open, run, wanted, address, picture_query(wanted.images))
        headers = {
            "Cache-Control": "no-store",
            "Content-Disposition": f'attachment; filename="{run}.{wanted.container}"',
        }
        media = MEDIA_TYPES[wanted.container]
        if is_head(request.scope):
            # A stream, because the length of an empty reply would be stated as 0.
            return StreamingResponse(iter(()), media_type=media, headers=headers)

        async def cut(part: BatchPart) -> tuple[CutPart, BatchPart | None]:
            return await threads.ask(batches.cut, batch, part)

        return StreamingResponse(stream(batch, cut), media_type=media, headers=headers)

    return routes
