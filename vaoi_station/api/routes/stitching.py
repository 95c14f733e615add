"""Routes under `board-types/{name}/reference` and `…/method`: reference and stitching method of a board type."""

from __future__ import annotations

import asyncio
from functools import partial
from typing import TypeVar
from urllib.parse import quote

from fastapi import APIRouter, Request, Response

from vaoi_station.api.http_caching import LIVE, require_unchanged, tag_of
from vaoi_station.api.parameters import BoardTypeName, IfMatch, rest_router
from vaoi_station.api.rest_models import MethodRequest, TeachRequest
from vaoi_station.api.routes.services import Services
from vaoi_station.errors import NotFoundError
from vaoi_station.runs.states.stitching_schemas import ReferenceStatus, StitchingMethod

Setting = TypeVar("Setting", StitchingMethod, ReferenceStatus)


def router(services: Services) -> APIRouter:
    """Create the routes for references and methods. A change applies from the next arming on."""
    routes = rest_router(prefix="/board-types/{name}", tags=["board types"])
    coordinator, ask = services.coordinator, services.commands.ask
    # Between the check of If-Match and the change no other caller may change the setting. Teaching copies frames.
    changing, teaching = asyncio.Lock(), asyncio.Lock()

    async def present_reference(request: Request, name: str) -> bytes | None:
        """Return the document of the reference; None if there is none, or the request has no condition."""
        if "if-match" not in request.headers and "if-none-match" not in request.headers:
            return None
        try:
            return _content(await ask(coordinator.reference, name))
        except NotFoundError:
            return None

    @routes.get("/reference", response_model_exclude_none=True)
    async def get_reference(response: Response, name: BoardTypeName) -> ReferenceStatus:
        """Return the board type's reference, and whether it is usable. Replies 404 `no-reference` if there is none."""
        response.headers["Cache-Control"] = LIVE
        return _tagged(response, await ask(coordinator.reference, name))

    @routes.put(
        "/reference",
        response_model_exclude_none=True,
        responses={201: {"model": ReferenceStatus, "description": "The board type had no reference before."}},
    )
    async def teach_reference(
        request: Request, response: Response, name: BoardTypeName, wanted: TeachRequest, _: IfMatch = None
    ) -> ReferenceStatus:
        """Make a finished run the reference of its board type, from the next arming on.

        Some frames of each row are copied to the disk. 409: the run's verdict is not ok, or the run has none yet; 410:
        the frames of the run are no longer in memory; 422: the run is of another board type. A run that is degraded
        only because its board may lie turned by 180° is accepted with `confirm_orientation`. With `If-Match: ETAG` only
        if the reference is still the one that the caller has read: else 412 `changed`.
        """
        response.headers["Cache-Control"] = LIVE
        teach = partial(coordinator.teach_reference, confirm_orientation=wanted.confirm_orientation)
        async with teaching:
            require_unchanged(request, await present_reference(request, name), f"The reference of {name!r}")
            if await ask(teach, name, wanted.run):
                response.status_code = 201
                response.headers["Location"] = quote(request.url.path)
            return _tagged(response, await ask(coordinator.reference, name))

    @routes.delete("/reference", status_code=204)
    async def forget_reference(request: Request, name: BoardTypeName, _: IfMatch = None) -> None:
        """Delete the reference of the board type. The change applies from the next arming on.

        With `If-Match: ETAG` only if it is still the one that the caller has read: else 412 `changed`.
        """
        async with teaching:
            require_unchanged(request, await present_reference(request, name), f"The reference of {name!r}")
            await ask(coordinator.forget_reference, name)

    @routes.get("/method", response_model_exclude_none=True)
    async def get_method(response: Response, name: BoardTypeName) -> StitchingMethod:
        """Return the stitching method of the board type: the one that was set for it, else the station's default."""
        response.headers["Cache-Control"] = LIVE
        return _tagged(response, await ask(coordinator.method, name))

    @routes.put("/method", response_model_exclude_none=True)
    async def set_method(
        request: Request, response: Response, name: BoardTypeName, wanted: MethodRequest, _: IfMatch = None
    ) -> StitchingMethod:
        """Set the stitching method of the board type, from the next arming on.

        With `If-Match: ETAG` only if it is still the one that the caller has read: else 412 `changed`.
        """
        response.headers["Cache-Control"] = LIVE
        async with changing:
            require_unchanged(request, _content(await ask(coordinator.method, name)), f"The method of {name!r}")
            return _tagged(response, await ask(coordinator.set_method, name, wanted.method))

    @routes.delete("/method", response_model_exclude_none=True)
    async def forget_method(
        request: Request, response: Response, name: BoardTypeName, _: IfMatch = None
    ) -> StitchingMethod:
        """Delete the method that was set for the board type. The default (`method` of station.toml) then applies."""
        response.headers["Cache-Control"] = LIVE
        async with changing:
            require_unchanged(request, _content(await ask(coordinator.method, name)), f"The method of {name!r}")
            return _tagged(response, await ask(coordinator.set_method, name, None))

    return routes


def _content(setting: StitchingMethod | ReferenceStatus) -> bytes:
    return setting.model_dump_json().encode()


def _tagged(response: Response, setting: Setting) -> Setting:
    """Add the ETag of a method or reference to its reply, and return it."""
    response.headers["ETag"] = tag_of(_content(setting))
    return setting
