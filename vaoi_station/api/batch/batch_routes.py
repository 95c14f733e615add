"""The route `runs/{id}/images`: the pictures of many components in one answer."""

from __future__ import annotations

from collections.abc import AsyncIterator
from typing import Annotated, Any, Literal
from urllib.parse import quote

from fastapi import APIRouter, Depends, Query, Request, Response
from fastapi.responses import StreamingResponse

from vaoi_station.api.batch.batch_stream import PARTS_AHEAD, CutThreads, stream
from vaoi_station.api.callers.caller import caller_of
from vaoi_station.api.callers.seats import QueuedSeats
from vaoi_station.api.images.image_queries import Wanted
from vaoi_station.api.images.view_entries import picture_query
from vaoi_station.api.parameters import RunId, parse_box, rest_router
from vaoi_station.api.request_guard import is_head
from vaoi_station.api.routes.services import Services
from vaoi_station.errors import InputError
from vaoi_station.runs.batches.batch_job import CutPart
from vaoi_station.runs.batches.batch_request import BatchRequest
from vaoi_station.runs.batches.batches import BatchPart
from vaoi_station.runs.batches.containers import MEDIA_TYPES, SUFFIXES, ContainerName

BATCHES, BATCHES_OF_CALLER, BATCHES_WAITING, BATCH_WAIT_S = 4, 2, 4, 20.0
"""Limits of batches under way in total and of one caller, and of those of one caller that wait; longest wait, s."""
STREAMS: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The files of the batch: run.json first, end.json last.",
        "content": {
            media.partition(";")[0]: {"schema": {"type": "string", "format": "binary"}}
            for media in MEDIA_TYPES.values()
        },
    }
}
_LONGEST_ADDRESS = 200


async def _request(
    wanted: Wanted,
    component: Annotated[
        list[str] | None,
        Query(
            description="Component, `ref` or `panel/ref`; give it once for each. Without it: all.", max_length=20_000
        ),
    ] = None,
    within: Annotated[
        str | None,
        Query(description="Only components whose centre is in this box: `x0,y0,x1,y1`, CAD.", max_length=200),
    ] = None,
    region: Annotated[
        str | None,
        Query(description="This part of the board in place of components: `x0,y0,x1,y1`, CAD.", max_length=200),
    ] = None,
    hdr: Annotated[
        bool, Query(description="One picture per component, merged of all its frames under one light.")
    ] = False,
    format: Annotated[
        Literal["png", "jpeg", "tiff", "npy", "raw"] | None,
        Query(description="Format of the pictures; by default png, and npy in npz. `raw` is the pixels alone."),
    ] = None,
    container: Annotated[ContainerName, Query(description="How files are packed; none is compressed.")] = "multipart",
) -> BatchRequest:
    for ref in component or ():
        if not 0 < len(ref) <= _LONGEST_ADDRESS:
            raise InputError.field("query", "component", ref, f"1 to {_LONGEST_ADDRESS} characters long")
    return BatchRequest(
        components=tuple(component or ()),
        within=parse_box("within", within),
        region=parse_box("region", region),
        images=wanted,
        hdr=hdr,
        format=format or ("npy" if container == "npz" else "png"),
        container=container,
    ).check()


def router(services: Services) -> APIRouter:
    """Create the route of batches."""
    routes = rest_router(prefix="/runs/{run}", tags=["pictures"])
    batches, threads = services.coordinator.batches, CutThreads(BATCHES * PARTS_AHEAD)
    seats = QueuedSeats("batches of pictures", BATCHES, BATCHES_OF_CALLER, BATCHES_WAITING, BATCH_WAIT_S)

    async def seat(request: Request) -> AsyncIterator[None]:
        """Hold a seat until the batch was read or its caller has gone."""
        async with seats.take(caller_of(request).name):
            yield

    @routes.get("/images", response_class=Response, responses=STREAMS, dependencies=[Depends(seat)])
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
            "Content-Disposition": f'attachment; filename="{run}.{SUFFIXES[wanted.container]}"',
        }
        media = MEDIA_TYPES[wanted.container]
        if is_head(request.scope):
            # A stream, because the length of an empty reply would be stated as 0.
            return StreamingResponse(iter(()), media_type=media, headers=headers)

        async def cut(part: BatchPart) -> tuple[CutPart, BatchPart | None]:
            return await threads.ask(batches.cut, batch, part)

        return StreamingResponse(stream(batch, cut), media_type=media, headers=headers)

    return routes
