"""Routes `runs/{id}/timeline` and `runs/{id}/overlay`."""

from __future__ import annotations

from fastapi import APIRouter, Request, Response

from vaoi_station.api.http_caching import IMMUTABLE, conditional_response
from vaoi_station.api.parameters import RunId, rest_router
from vaoi_station.api.routes.services import Services
from vaoi_station.runs.states.overlay_schemas import RunOverlay
from vaoi_station.runs.states.timeline_schemas import Timeline


def router(services: Services) -> APIRouter:
    """Create the routes."""
    routes = rest_router(prefix="/runs/{run}", tags=["runs"])
    coordinator, ask = services.coordinator, services.commands.ask

    @routes.get("/timeline", response_model=Timeline)
    async def get_timeline(request: Request, run: RunId) -> Response:
        """Return the times of the steps of a finished run: barrier, pulses, exposures, frames, stitching, result.

        All are seconds since the board interrupted the light barrier.
        """
        content = (await ask(coordinator.timeline, run)).model_dump_json(exclude_none=True).encode()
        return conditional_response(request, content, "application/json", cache=IMMUTABLE)

    @routes.get("/overlay", response_model=RunOverlay)
    async def get_overlay(request: Request, run: RunId) -> Response:
        """Return what is drawn over the mosaics of a run: its frames, links, fiducials and residuals on the board.

        Places are CAD coordinates, as `image_from_cad` of a mosaic takes them. No frames are needed. 409: the run has
        no CAD mapping.
        """
        content = (await ask(coordinator.mosaics.overlay, run)).model_dump_json(exclude_none=True).encode()
        return conditional_response(request, content, "application/json", cache=IMMUTABLE)

    return routes
