"""Routes under `runs/{id}/frames`, `…/components` and `…/merged`: frames, temporary images, merged pictures."""

from __future__ import annotations

import re
from typing import Annotated, Any, Literal, get_args
from urllib.parse import quote, urlencode

from fastapi import APIRouter, Depends, Header, Path, Query, Request, Response
from pydantic import BaseModel, Field

from vaoi_station.api.encoders import MEDIA_TYPES, ImageFormat, choose_format, encode_image, raw_from_npy
from vaoi_station.api.http_caching import IMMUTABLE, LIVE, REVALIDATE, conditional_response, json_response, matches
from vaoi_station.api.parameters import (
    FOR_CACHES,
    Address,
    Camera,
    FormatName,
    RouteWithoutQuery,
    Row,
    RunId,
    file_reply,
    parse_box,
    rest_router,
)
from vaoi_station.api.problems import problem_response
from vaoi_station.api.rest_models import (
    ComponentEntry,
    ComponentList,
    ComponentViews,
    MergedEntry,
    MergedList,
    ViewEntry,
)
from vaoi_station.api.routes.services import Services
from vaoi_station.rendering import ImageRequest
from vaoi_station.rendering.request import MOST_IMAGES, MOST_MARGIN_MM, Alignment, Order, Plane, direction
from vaoi_station.rendering.selection import component_covariances, describe
from vaoi_station.runs.batches.batches import merged_entry
from vaoi_station.runs.merging.merged_pictures import MergeRequest
from vaoi_station.runs.states.schemas import ImageFormat as Rendered
from vaoi_station.runs.states.tables import FINISHED

Accept = Annotated[str | None, Header(max_length=500)]
Index = Annotated[int, Path(description="Index of the view, from 0.", ge=0, le=99_999)]
Number = Annotated[float, Field(allow_inf_nan=False)]
Resolution = Annotated[
    Number | None,
    Field(description="Resolution of the temporary images; default: the station's setting.", ge=0.5, le=500),
]
PICTURE = file_reply("The image; X-Image-* headers describe raw pixels.", *MEDIA_TYPES.values())
RENDERED_AS: dict[ImageFormat, Rendered] = {
    **{ImageFormat(name): name for name in get_args(Rendered)},
    ImageFormat.RAW: "npy",
}
"""For each format of a reply, the format requested from the coordinator. Raw is npy without the header."""
_ONE_RANGE = re.compile(r"bytes=(\d{0,15})-(\d{0,15})")


class ImageQuery(BaseModel):
    """The options of a request for temporary images, as `ImageRequest` has them."""

    px_per_mm: Resolution = None
    margin_mm: Number = Field(
        default=0.0, description="Strip of surroundings on all sides of the component.", ge=0, le=MOST_MARGIN_MM
    )
    align: Alignment = Field(default="cad", description="What is upright: CAD, or the component as at rotation 0.")
    plane: Plane = Field(
        default="board",
        description="Plane in which the images are right: the board's surface, or the top of the body.",
    )
    min_coverage: Number = Field(
        default=0.5, description="Omit frames that show less than this share of the component.", gt=0, le=1
    )
    min_exposure_us: Number | None = Field(default=None, description="Least exposure time.", ge=0)
    max_exposure_us: Number | None = Field(default=None, description="Longest exposure time.", ge=0)
    min_angle_deg: Number = Field(
        default=0.0, description="Least angle between line of sight and vertical.", ge=0, le=90
    )
    max_angle_deg: Number = Field(default=90.0, description="Largest such angle.", ge=0, le=90)
    min_sharpness_per_mm: Number | None = Field(default=None, description="Least sharpness.", ge=0)
    max_saturated: Number | None = Field(default=None, description="Largest share of saturated pixels.", ge=0, le=1)
    light: str | None = Field(default=None, description="Only images under this light.", max_length=200)
    minus: str | None = Field(
        default=None,
        description="Subtract the image under this light, seen most nearly from the same side.",
        max_length=200,
    )
    seen_from: str | None = Field(
        default=None,
        description="Only images that see the component from this side of the image (`left`, `right`, `front`: below, "
        "`back`: above), or from this azimuth in CAD, 0 to 360.",
        max_length=20,
    )
    within_deg: Number | None = Field(
        default=None, description="Largest difference from `seen_from` [45]; only with it.", ge=0, le=180
    )
    order: Order = Field(default="best", description="What comes first; see the guide.")
    limit: int | None = Field(default=None, description="Largest number of images.", ge=1, le=MOST_IMAGES)
    measure: bool = Field(default=False, description="Measure sharpness and saturation of every image.")


# Coroutines, because FastAPI performs other functions in a thread, which takes longer than the functions.
async def _wanted(query: Annotated[ImageQuery, Query()]) -> ImageRequest:
    options: Any = dict(query) | {"seen_from": direction(query.seen_from)}
    return ImageRequest.of(options)


Wanted = Annotated[ImageRequest, Depends(_wanted)]
"""The request for images that the query of an HTTP request makes."""


def picture_query(wanted: ImageRequest) -> str:
    """Return the query for the address of an image: that of the list to which the image's index k refers."""
    # Default values are omitted: one image then has one address, which caches can use.
    asked = wanted.unmeasured().options()
    return "?" + urlencode(asked) if asked else ""


class MergeQuery(BaseModel):
    """The parameters of merged pictures."""

    component: str | None = Field(
        default=None,
        description="Component: `ref`, or `panel/ref` on a panel; or give `region`.",
        min_length=1,
        max_length=200,
    )
    region: str | None = Field(
        default=None,
        description="Part of the board: `x0,y0,x1,y1` in CAD coordinates; or give `component`.",
        max_length=200,
    )
    light: str | None = Field(
        default=None, description="Merge the frames under this light; default: that of most frames.", max_length=100
    )
    px_per_mm: Resolution = None
    min_coverage: Number = Field(default=0.02, description="Omit frames that show less than this share.", gt=0, le=1)


async def _merge_request(query: Annotated[MergeQuery, Query()]) -> MergeRequest:
    return MergeRequest(
        query.component, parse_box("region", query.region), query.light, query.px_per_mm, query.min_coverage
    )


Merged = Annotated[MergeRequest, Depends(_merge_request)]


def router(services: Services) -> APIRouter:
    """Create the routes. `{ref}` in a path is a component's address: `ref`, or `panel/ref`."""
    routes = rest_router(prefix="/runs/{run}", tags=["pictures"])
    coordinator, ask, pictures = services.coordinator, services.commands.ask, services.pictures
    with_seat: dict[str, Any] = {"response_class": Response, "dependencies": [Depends(services.picture_seats.hold)]}

    @routes.get(
        "/frames/{camera}/{row}",
        responses={**PICTURE, 206: {**PICTURE[200], "description": "The bytes of the header Range."}},
        **with_seat,
    )
    async def get_frame(
        *,
        request: Request,
        run: RunId,
        camera: Camera,
        row: Row,
        format: FormatName = None,
        accept: Accept = None,
        incomplete: Annotated[
            Literal["refuse", "show"], Query(description="Whether an incomplete or unproven frame is returned.")
        ] = "refuse",
    ) -> Response:
        """Return one frame as PNG, TIFF, npy or raw, all without loss. An incomplete frame needs `incomplete=show`.

        So does a frame that is not proven to belong to its row (409 `frame-unproven`). The header X-Frame-Verdict is
        `ok`, `incomplete` or `unproven`. 410: the frame is no longer in memory,
        and not in a recording that is kept of the run. The header Range selects some of the bytes (206): of a raw
        frame, line k begins at byte k · X-Image-Stride.
        """
        image_format = choose_format(format, accept)

        def picture() -> tuple[bytes, dict[str, str]]:
            pixels, record = coordinator.frame(run, camera, row, incomplete == "show")
            content, headers = encode_image(pixels, image_format)
            return content, headers | {"X-Frame-Verdict": str(record.verdict) if record.proven else "unproven"}

        content, headers = await pictures.ask(picture)
        return part_of(request, conditional_response(request, content, MEDIA_TYPES[image_format], headers=headers))

    def caching_now(run: str, wanted: ImageRequest | None = None) -> str:
        """Return how an answer may be kept; call it in a thread, and before the content is made."""
        if coordinator.run(run).state not in FINISHED:
            return LIVE
        # Colours are balanced by the flat fields in force, which may be measured again.
        if coordinator.balances_colours:
            return REVALIDATE
        # Heights are measured after the result: until they are known, images on the tops of bodies may change.
        final = wanted is None or wanted.framing.plane != "top" or coordinator.heights.known(run) is not None
        return IMMUTABLE if final and coordinator.is_complete(run) else REVALIDATE

    async def caching(run: str, wanted: ImageRequest | None = None) -> str:
        return await ask(caching_now, run, wanted)

    @routes.get("/components", response_model=ComponentList, dependencies=[Depends(services.search_seats.hold)])
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
            parts = [c for c in coordinator.components(run) if unseen in (None, c.unseen)]
            entries = [
                ComponentEntry(
                    **c.model_dump(exclude={"panel"}),
                    panel=None if c.panel is None else str(c.panel),
                    url=f"{path}/{quote(c.address)}",
                )
                for c in parts
            ]
            return json_response(request, ComponentList(components=entries), cache)

        # 20,000 components become some megabytes of text, which takes too long for the event loop.
        return await services.searching.ask(listed)

    async def image_of(
        request: Request, component: tuple[str, str, int], wanted: ImageRequest, wire: ImageFormat
    ) -> Response:
        def picture() -> tuple[bytes, str]:
            run, ref, k = component
            cache = caching_now(run, wanted)
            return coordinator.image(run, ref, k, wanted, format=RENDERED_AS[wire]), cache

        content, cache = await pictures.ask(picture)
        return _picture(request, content, wire, cache)

    async def get_plain_component_image(
        *, request: Request, run: RunId, ref: Address, k: Index, accept: Accept = None
    ) -> Response:
        return await image_of(request, (run, ref, k), plain, choose_format(None, accept))

    plain = ImageRequest().check()
    # Before "/components/{ref:path}", whose path parameter would match these addresses as well.
    image = "/components/{ref:path}/images/{k}"
    routes.add_api_route(
        image, get_plain_component_image, include_in_schema=False, route_class_override=RouteWithoutQuery, **with_seat
    )

    @routes.get(image, responses=PICTURE, **with_seat)
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

    @routes.get("/components/{ref:path}", response_model=ComponentViews)
    async def get_component(request: Request, run: RunId, ref: Address, wanted: Wanted) -> Response:
        """List the frames that show a component, best first, with the addresses of their temporary images."""
        # Measuring reads pixels, like rendering; its callers wait in the same queue.
        reads = wanted.needs_pixels or wanted.choice.measure
        cache = await caching(run, wanted)
        images = await (pictures.ask if reads else ask)(lambda: coordinator.images(run, ref, wanted))
        address, query = quote(request.url.path), picture_query(wanted)
        certain = component_covariances(await ask(coordinator.stitch, run), ref) if images.chosen else {}
        entries = []
        for k, choice in enumerate(images.chosen):
            covariance_px2 = images.covariance_px2(choice, certain.get((choice.view.camera, choice.view.row)))
            entries.append(ViewEntry(k=k, url=f"{address}/images/{k}{query}", **describe(choice, covariance_px2)))
        views = ComponentViews(
            address=ref,
            px_per_mm=entries[0].px_per_mm if entries else None,
            remark=images.remark,
            plane_source=None if images.height is None else images.height.source,
            plane_sigma_mm=None if images.height is None else images.height.sigma_mm,
            views=entries,
        )
        return json_response(request, views, cache)

    @routes.get("/merged", response_model=MergedList)
    async def list_merged(*, request: Request, run: RunId, wanted: Merged) -> Response:
        """List the merged pictures of a component or a region, with their frames and matrices.

        Frames of different exposures under one light are merged to linear radiance, in the plane of the component's
        top.
        """
        choices = await ask(coordinator.merged.pictures, run, wanted)
        query = {k: v for k, v in request.query_params.items() if k != FOR_CACHES}
        query["min_coverage"] = str(wanted.min_coverage)
        address = f"{quote(request.url.path)}/image?"
        entries = [
            MergedEntry(k=k, url=address + urlencode(query | {"k": str(k)}), **merged_entry(choice))
            for k, choice in enumerate(choices)
        ]
        return json_response(request, MergedList(pictures=entries), REVALIDATE)

    @routes.get("/merged/image", responses=PICTURE, **with_seat)
    async def get_merged_image(
        *,
        request: Request,
        run: RunId,
        wanted: Merged,
        k: Annotated[
            int | None,
            Query(
                description="Index of the picture, from 0; default: the last, of all frames of the light.",
                ge=0,
                le=99_999,
            ),
        ] = None,
        sigma: Annotated[
            bool,
            Query(
                description="Return the standard deviation of every pixel in place of the radiance (npy, tiff, raw)."
            ),
        ] = False,
        format: FormatName = None,
        accept: Accept = None,
    ) -> Response:
        """Return a merged picture: linear radiance as npy, TIFF or raw floats, tone-mapped 8 bit as PNG or JPEG.

        Radiance is in grey levels per µs at gain 1; NaN where no frame gives a valid value (black in 8 bit). Pass the
        same parameters as for the list, to which index k refers. 410: the frames are no longer in memory, and no
        recording of the run is kept.
        """
        image_format = choose_format(format, accept)
        content = await pictures.ask(
            lambda: coordinator.merged.image(run, wanted, k, RENDERED_AS[image_format], sigma=sigma)
        )
        # Other flat fields give other pictures of the same run.
        return _picture(request, content, image_format, REVALIDATE)

    return routes


def _picture(request: Request, content: bytes, image_format: ImageFormat, cache: str) -> Response:
    headers: dict[str, str] = {}
    if image_format is ImageFormat.RAW:
        content, headers = raw_from_npy(content)
    return conditional_response(request, content, MEDIA_TYPES[image_format], cache=cache, headers=headers)


def part_of(request: Request, whole: Response) -> Response:
    """Return the part of a reply that the header Range asks for (RFC 9110, section 14); the whole reply without one.

    Several ranges, and headers that cannot be read, are answered with the whole reply, as the standard permits.
    """
    if whole.status_code != 200:
        return whole
    size = len(whole.body)
    whole.headers["Accept-Ranges"] = "bytes"
    asked = _ONE_RANGE.fullmatch(request.headers.get("range", "").strip())
    # If-Range names the ETag of the bytes that the caller means.
    tag = request.headers.get("if-range")
    meant = tag is None or (matches(tag, whole.headers.get("etag", "")) and not tag.startswith("W/"))
    if asked is None or asked.groups() == ("", "") or not meant:
        return whole
    first, last = asked.groups()
    start = int(first) if first else max(0, size - int(last))
    end = min(int(last) if first and last else size - 1, size - 1)
    if first and last and int(last) < int(first):
        return whole
    if start >= size:
        detail = f"The range begins at byte {start}, but there are {size} bytes."
        unsatisfied = {"Content-Range": f"bytes */{size}"}
        return problem_response(request.scope, "range-not-satisfiable", detail, headers=unsatisfied)
    headers = {name: value for name, value in whole.headers.items() if name != "content-length"}
    headers["Content-Range"] = f"bytes {start}-{end}/{size}"
    return Response(bytes(whole.body[start : end + 1]), 206, headers)
