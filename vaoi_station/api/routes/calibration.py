"""Routes under `calibration`: the calibration in use, and the drift of each camera."""

from __future__ import annotations

from fastapi import APIRouter, Response

from vaoi_station.api.http_caching import LIVE
from vaoi_station.api.parameters import rest_router
from vaoi_station.api.routes.services import Services
from vaoi_station.runs.states.calibration_schemas import CalibrationStatus


def router(services: Services) -> APIRouter:
    """Create the route for the calibration in use."""
    routes = rest_router(prefix="/calibration", tags=["station"])

    @routes.get("", response_model_exclude_none=True)
    async def get_calibration(response: Response) -> CalibrationStatus:
        """Return the calibration in use, and for each camera its state, its drift (size and start) and its history.

        A displacement is the camera's motion since its calibration, in px of its frame, estimated from filmed boards.
        """
        response.headers["Cache-Control"] = LIVE
        return await services.commands.ask(services.coordinator.calibration)

    return routes
