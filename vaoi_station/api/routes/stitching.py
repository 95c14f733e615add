"""`board-types/{name}/reference` and `…/method`: how boards of a type are stitched, and against what."""

from __future__ import annotations

from urllib.parse import quote

from fastapi import APIRouter, Request, Response

from vaoi_station.api.http_caching import LIVE
from vaoi_station.api.parameters import BoardTypeName
from vaoi_station.api.rest_models import MethodRequest, TeachRequest
from vaoi_station.api.services import Services
from vaoi_station.runs.states.schemas import ReferenceStatus, StitchingMethod


def router(services: Services) -> APIRouter:
    """References and methods; what is changed holds from the next arming on."""
    routes = APIRouter(prefix="/board-types/{name}", tags=["board types"])
    coordinator, ask = services.coordinator, services.commands.ask

    @routes.get("/reference", response_model_exclude_none=True)
    async def get_reference(response: Response, name: BoardTypeName) -> ReferenceStatus:
        """The run that boards of this type are placed against, and whether it can be used; 404 `no-reference`."""
        response.headers["Cache-Control"] = LIVE
        return await ask(coordinator.reference, name)

    @routes.put(
        "/reference",
        response_model_exclude_none=True,
        responses={201: {"model": ReferenceStatus, "description": "It had none before."}},
    )
    async def teach_reference(
        request: Request, response: Response, name: BoardTypeName, wanted: TeachRequest
    ) -> ReferenceStatus:
        """Make a finished run the reference of its board type; holds from the next arming on.

        A small set of frames of each row is copied to the disk. 409: the run's verdict is not ok, or it has none
        yet; 410: its frames are no longer in memory; 422: it shows another board type.
        """
        response.headers["Cache-Control"] = LIVE
        if await ask(coordinator.teach_reference, name, wanted.run):
            response.status_code = 201
            response.headers["Location"] = quote(request.url.path)
        return await ask(coordinator.reference, name)

    @routes.delete("/reference", status_code=204)
    async def forget_reference(name: BoardTypeName) -> None:
        """Place boards without a reference, from the next arming on."""
        await ask(coordinator.forget_reference, name)

    @routes.get("/method", response_model_exclude_none=True)
    async def get_method(response: Response, name: BoardTypeName) -> StitchingMethod:
        """How boards of this type are stitched: by a way of their own, or by the station's."""
        response.headers["Cache-Control"] = LIVE
        return await ask(coordinator.method, name)

    @routes.put("/method", response_model_exclude_none=True)
    async def set_method(response: Response, name: BoardTypeName, wanted: MethodRequest) -> StitchingMethod:
        """Give the board type a way of its own, from the next arming on."""
        response.headers["Cache-Control"] = LIVE
        return await ask(coordinator.set_method, name, wanted.method)

    @routes.delete("/method", response_model_exclude_none=True)
    async def forget_method(response: Response, name: BoardTypeName) -> StitchingMethod:
        """The station's way (`method` of station.toml) holds again."""
        response.headers["Cache-Control"] = LIVE
        return await ask(coordinator.set_method, name, None)

    return routes
