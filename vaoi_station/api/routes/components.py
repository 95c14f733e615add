"""Routes under `runs/{id}/components`: positions of components, frames that show them, temporary images."""

from __future__ import annotations

from typing import Annotated
from urllib.parse import quote

from fastapi import APIRouter, Depends, Path, Query, Request, Response

from vaoi_station.api.encoders import MEDIA_TYPES, ImageFormat, choose_format, raw_from_npy
from vaoi_station.api.http_caching import IMMUTABLE, LIVE, REVALIDATE, conditional_response
from vaoi_station.api.images.image_queries import Wanted
from vaoi_station.api.images.route_without_query import RouteWithoutQuery
from vaoi_station.api.images.view_entries import covariances, picture_query, view_entry
from vaoi_station.api.parameters import Address, FormatName, RunId, rest_router
from vaoi_station.api.rest_models import ComponentEntry, ComponentList, ComponentViews
from vaoi_station.api.routes.frames import PICTURE, Accept
from vaoi_station.api.routes.services import Services
from vaoi_station.rendering import ImageRequest
from vaoi_station.runs.states.schemas import ComponentSummary
from vaoi_station.runs.states.schemas import ImageFormat as Rendered
from vaoi_station.runs.states.tables import FINISHED

Index = Annotated[int, Path(description="Index of the view, from 0.", ge=0, le=99_999)]

IMAGE = "/{ref:path}/images/{k}"
_PLAIN = ImageRequest()
"""What a request without a query asks for."""
RENDERED_AS: dict[ImageFormat, Rendered] = {
    ImageFormat.PNG: "png",
    ImageFormat.JPEG: "jpeg",
    ImageFormat.TIFF: "tiff",
    ImageFormat.NPY: "npy",
    ImageFormat.RAW: "npy",
}
"""For each format of a reply, the format requested from the coordinator. Raw is npy without the header."""


def router(services: Services) -> APIRouter:
    """Create the routes for components. `{ref}` in a path is a component's address: `ref`, or `panel/ref`."""
    routes = rest_router(prefix="/runs/{run}/components", tags=["pictures"])
    coordinator, ask = services.coordinator, services.commands.ask

    async def caching(run: str, cache: str = IMMUTABLE) -> str:
        return cache if (await ask(coordinator.run, run)).state in FINISHED else LIVE

    def answer(request: Request, content: ComponentList | ComponentViews, cache: str) -> Response:
        body = content.model_dump_json(exclude_none=True).encode()
        return conditional_response(request, body, "application/json", cache=cache)

    def picture_caching(run: str, wanted: ImageRequest) -> str:
        # Heights are measured after the result: until they are known, images on the tops of bodies may change.
        final = wanted.framing.plane != "top" or coordinator.heights.known(run) is not None
        return IMMUTABLE if final else REVALIDATE

    @routes.get("", response_model=ComponentList, dependencies=[Depends(services.searches.hold)])
    async def list_components(
        request: Request,
        run: RunId,
        unseen: Annotated[
            bool | None, Query(description="Only those of which too little is seen, or the others.")
        ] = None,
    ) -> Response:
        """List the components of the run's board type with their positions."""
        path, cache = quote(request.url.path), await caching(run)

        def listed() -> Response:
            found = [c for c in coordinator.components(run) if unseen in (None, c.unseen)]
            entries = [_entry(c, f"{path}/{quote(c.address)}") for c in found]
            return answer(request, ComponentList(components=entries), cache)

        # 20,000 components become some megabytes of text, which takes too long for the event loop.
        return await services.searches.ask(listed)

    async def image_of(
        request: Request, component: tuple[str, str, int], wanted: ImageRequest, image_format: ImageFormat
    ) -> Response:
        def picture() -> tuple[bytes, dict[str, str], str]:
            run, ref, k = component
            cache = picture_caching(run, wanted)
            content = coordinator.image(run, ref, k, wanted, format=RENDERED_AS[image_format])
            return (*(raw_from_npy(content) if image_format is ImageFormat.RAW else (content, {})), cache)

        content, headers, cache = await services.pictures.ask(picture)
        return conditional_response(request, content, MEDIA_TYPES[image_format], headers=headers, cache=cache)

    # Before "/{ref:path}", whose path parameter would match these addresses as well.
    async def get_plain_component_image(
        *, request: Request, run: RunId, ref: Address, k: Index, accept: Accept = None
    ) -> Response:
        return await image_of(request, (run, ref, k), _PLAIN, choose_format(None, accept))

    routes.add_api_route(
        IMAGE,
        get_plain_component_image,
        include_in_schema=False,
        response_class=Response,
        dependencies=[Depends(services.picture_seats.hold)],
        route_class_override=RouteWithoutQuery,
    )

    @routes.get(IMAGE, response_class=Response, responses=PICTURE, dependencies=[Depends(services.picture_seats.hold)])
    async def get_component_image(
        *,
        request: Request,
        run: RunId,
        ref: Address,
        k: Index,
        wanted: Wanted,
        format: FormatName = None,
        accept: Accept = None,
    ) -> Response:
        """Return temporary image k of a component: cut from one frame, upright, aligned with the CAD axes.

        Pass the same parameters as for the list of views, to which index k refers. 410: the frames
        are no longer in memory, and no recording of the run is kept.
        """
        return await image_of(request, (run, ref, k), wanted, choose_format(format, accept))

    @routes.get("/{ref:path}", response_model=ComponentViews)
    async def get_component(request: Request, run: RunId, ref: Address, wanted: Wanted) -> Response:
        """List the frames that show a component, best first, with the addresses of their temporary images."""
        # Measuring reads pixels, like rendering; its callers wait in the same queue.
        reads = wanted.needs_pixels or wanted.choice.measure
        cache = await ask(picture_caching, run, wanted)
        found = await (services.pictures.ask if reads else ask)(lambda: coordinator.images(run, ref, wanted))
        address = quote(request.url.path)
        query = picture_query(wanted)
        certain = covariances((await ask(coordinator.stitch, run)).quality, ref) if found.chosen else {}
        entries = [
            view_entry(
                k,
                choice,
                f"{address}/images/{k}{query}",
                found.covariance_px2(choice, certain.get((choice.view.camera, choice.view.row))),
            )
            for k, choice in enumerate(found.chosen)
        ]
        resolution = entries[0].px_per_mm if entries else None
        views = ComponentViews(
            address=ref,
            px_per_mm=resolution,
            remark=found.remark,
            plane_source=None if found.height is None else found.height.source,
            plane_sigma_mm=None if found.height is None else found.height.sigma_mm,
            views=entries,
        )
        return answer(request, views, await caching(run, cache))

    return routes


def _entry(component: ComponentSummary, url: str) -> ComponentEntry:
    fields = component.model_dump()
    fields["panel"] = None if component.panel is None else str(component.panel)
    return ComponentEntry(**fields, url=url)
