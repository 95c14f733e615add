"""Route of the check of a light program."""

from __future__ import annotations

from fastapi import APIRouter, Response

from vaoi_station.api.http_caching import LIVE
from vaoi_station.api.lighting.models import ProgramRequest
from vaoi_station.api.parameters import BoardTypeName, rest_router
from vaoi_station.api.routes.services import Services
from vaoi_station.runs.lighting.program_schemas import ProgramCheck


def router(services: Services) -> APIRouter:
    """Create the route."""
    routes = rest_router(tags=["board types"])
    coordinator, ask = services.coordinator, services.commands.ask

    @routes.post("/board-types/{name}/program/check", response_model_exclude_none=True)
    async def check_light_program(response: Response, name: BoardTypeName, body: ProgramRequest) -> ProgramCheck:
        """Check a light program as if the line were armed with it: all faults at once, each with its limit.

        Nothing is changed. The reply states all values of the steps, and the limits of cameras, lights and line.
        """
        response.headers["Cache-Control"] = LIVE
        board_type = await ask(coordinator.board_type, name)
        return await ask(coordinator.lighting.programs.check, board_type, body.program)

    return routes
