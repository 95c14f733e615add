"""Routes under `events`: the event log as server-sent events. A client can resume the stream."""

from __future__ import annotations

from collections.abc import AsyncIterator
from datetime import UTC, datetime
from typing import Annotated

from fastapi import APIRouter, Depends, Header, Query, Request
from fastapi.sse import EventSourceResponse, ServerSentEvent

from vaoi_station.api.access import still_known
from vaoi_station.api.parameters import rest_router
from vaoi_station.api.rest_models import Heartbeat
from vaoi_station.api.routes.services import Services
from vaoi_station.errors import InputError
from vaoi_station.runs.states.schemas import EventRecord

HEARTBEAT_S = 2.0
RECONNECT_MS = 1000


def router(services: Services) -> APIRouter:
    """Create the route for the event stream."""
    routes = rest_router(tags=["events"])

    async def start(
        after: Annotated[int | None, Query(ge=0, le=2**53, description="Number of the last event received.")] = None,
        last_event_id: Annotated[str | None, Header(description="The same, sent by a client that reconnects.")] = None,
    ) -> int:
        """Return the number of the event after which the stream starts."""
        newest = (await services.commands.ask(services.coordinator.snapshot)).last_event
        if last_event_id:
            if not (last_event_id.isascii() and last_event_id.isdecimal() and len(last_event_id) < 17):
                raise InputError.field("header", "Last-Event-ID", last_event_id, "the id of an event, a whole number")
            after = int(last_event_id)
        return newest if after is None else min(after, newest)

    # The seat is taken first, so that a refused stream asks nothing of the coordinator, and before the first header is
    # sent, so that the refusal can still be a 503.
    seat = Depends(services.hub.streams.hold)

    @routes.get("/events", response_class=EventSourceResponse)
    async def stream_events(
        request: Request, _: None = seat, after: int = Depends(start)
    ) -> AsyncIterator[ServerSentEvent]:
        """Stream every event as one message whose id is its number, in order and without gaps.

        Resume with `Last-Event-ID` (browsers send it automatically) or `?after=`; without either, the stream starts
        with the next event. After two seconds without an event, an event `heartbeat` reports state and time. The stream
        ends when the caller's key is revoked or rotated.
        """
        yield await _heartbeat(services)
        while not services.hub.closed:
            records = await services.hub.events(after, HEARTBEAT_S)
            if not await services.commands.ask(still_known, request.scope):
                return
            for record in records:
                after = record.number
                yield _message(record)
            if not records and not services.hub.closed:
                yield await _heartbeat(services)

    return routes


def _message(record: EventRecord) -> ServerSentEvent:
    return ServerSentEvent(raw_data=record.model_dump_json(exclude_none=True), id=str(record.number))


async def _heartbeat(services: Services) -> ServerSentEvent:
    """Return a heartbeat event that contains the coordinator's state."""
    # The coordinator's thread gives the state, so heartbeats also stop if that thread hangs, not only the network.
    now = await services.commands.ask(services.coordinator.snapshot)
    heartbeat = Heartbeat(time=datetime.now(UTC).isoformat(), state=now.state, last_event=now.last_event)
    return ServerSentEvent(raw_data=heartbeat.model_dump_json(), event="heartbeat", retry=RECONNECT_MS)
