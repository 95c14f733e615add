"""`calibration`: the one in force, and how the cameras stand to it."""

from __future__ import annotations

from fastapi import APIRouter, Response

from vaoi_station.api.http_caching import LIVE
from vaoi_station.api.services import Services
from vaoi_station.runs.states.calibration_schemas import CalibrationStatus


def router(services: Services) -> APIRouter:
    """The calibration in force."""
    routes = APIRouter(prefix="/calibration", tags=["station"])

    @routes.get("", response_model_exclude_none=True)
    async def get_calibration(response: Response) -> CalibrationStatus:
        """The calibration in force, and camera by camera whether it still holds: a drift with its size and since when.

        Displacements are in px of the camera's frame against its calibration, from the boards that have passed.
        """
        response.headers["Cache-Control"] = LIVE
        return await services.commands.ask(services.coordinator.calibration)

    return routes
