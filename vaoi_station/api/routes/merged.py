"""Routes under `runs/{id}/merged`: pictures that are merged of several exposures, in linear radiance."""

from __future__ import annotations

from typing import Annotated
from urllib.parse import quote, urlencode

from fastapi import APIRouter, Depends, Query, Request, Response
from pydantic import Field

from vaoi_station.api.encoders import MEDIA_TYPES, ImageFormat, choose_format, raw_from_npy
from vaoi_station.api.http_caching import REVALIDATE, conditional_response
from vaoi_station.api.parameters import FOR_CACHES, FormatName, PxPerMm, RunId, parse_box, rest_router
from vaoi_station.api.rest_models import Matrix3
from vaoi_station.api.routes.components import RENDERED_AS
from vaoi_station.api.routes.frames import PICTURE, Accept
from vaoi_station.api.routes.services import Services
from vaoi_station.model import Strict
from vaoi_station.runs.batches.batches import merged_entry
from vaoi_station.runs.merging.merged_pictures import MergedChoice, MergeRequest

Component = Annotated[
    str | None,
    Query(description="Component: `ref`, or `panel/ref` on a panel; or give `region`.", min_length=1, max_length=200),
]
Region = Annotated[
    str | None,
    Query(description="Part of the board: `x0,y0,x1,y1` in CAD coordinates; or give `component`.", max_length=200),
]
Light = Annotated[
    str | None, Query(description="Merge the frames under this light; default: that of most frames.", max_length=100)
]
LeastCoverage = Annotated[
    float,
    Query(description="Omit frames that show less than this share.", gt=0, le=1, allow_inf_nan=False),
]
Index = Annotated[
    int | None,
    Query(description="Index of the picture, from 0; default: the last, of all frames of the light.", ge=0, le=99_999),
]
Sigma = Annotated[
    bool, Query(description="Return the standard deviation of every pixel in place of the radiance (npy, tiff, raw).")
]


class MergedEntry(Strict):
    """One merged picture. Matrices act on column vectors (x, y, 1)."""

    k: int
    merged: list[tuple[int, int]] = Field(description="[camera, row] of the frames it is merged of, best first.")
    exposures: int = Field(description="Number of different exposures; with 1, saturated places have no value.")
    lights: list[str] = Field(description="The light of the frames; empty if lights have no names.")
    width_px: int
    height_px: int
    px_per_mm: float
    plane_height_mm: float = Field(description="Height above the board of the plane in which frames are merged.")
    crop_from_cad: Matrix3 = Field(description="CAD coordinates (unit of the board type) to pixels of the picture.")
    cad_from_crop: Matrix3
    url: str = Field(description="Address of the picture.")


class MergedList(Strict):
    """The merged pictures of a component or region: the paper's m_v pictures, and last the one of all frames."""

    pictures: list[MergedEntry]


async def _wanted(
    component: Component = None,
    region: Region = None,
    light: Light = None,
    px_per_mm: PxPerMm = None,
    min_coverage: LeastCoverage = 0.02,
) -> MergeRequest:
    """Return what the query asks for."""
    return MergeRequest(component, parse_box("region", region), light, px_per_mm, min_coverage)


Wanted = Annotated[MergeRequest, Depends(_wanted)]


def router(services: Services) -> APIRouter:
    """Create the routes for merged pictures."""
    routes = rest_router(prefix="/runs/{run}/merged", tags=["pictures"])
    coordinator, ask = services.coordinator, services.commands.ask

    @routes.get("", response_model=MergedList)
    async def list_merged(
        *,
        request: Request,
        run: RunId,
        wanted: Wanted,
    ) -> Response:
        """List the merged pictures of a component or a region, with their frames and matrices.

        Frames of different exposures under one light are merged to linear radiance, in the plane of the component's
        top.
        """
        choices = await ask(coordinator.merged.pictures, run, wanted)
        query = {k: v for k, v in request.query_params.items() if k != FOR_CACHES}
        query["min_coverage"] = str(wanted.min_coverage)
        entries = [
            _entry(k, choice, f"{quote(request.url.path)}/image?{urlencode(query | {'k': str(k)})}")
            for k, choice in enumerate(choices)
        ]
        body = MergedList(pictures=entries).model_dump_json(exclude_none=True).encode()
        return conditional_response(request, body, "application/json", cache=REVALIDATE)

    @routes.get(
        "/image",
        response_class=Response,
        responses=PICTURE,
        dependencies=[Depends(services.picture_seats.hold)],
    )
    async def get_merged_image(
        *,
        request: Request,
        run: RunId,
        wanted: Wanted,
        k: Index = None,
        sigma: Sigma = False,
        format: FormatName = None,
        accept: Accept = None,
    ) -> Response:
        """Return a merged picture: linear radiance as npy, TIFF or raw floats, tone-mapped 8 bit as PNG or JPEG.

        Radiance is in grey levels per µs at gain 1; NaN where no frame gives a valid value (black in 8 bit). Pass the
        same parameters as for the list, to which index k refers. 410: the frames are no longer in memory, and no
        recording of the run is kept.
        """
        image_format = choose_format(format, accept)

        def picture() -> tuple[bytes, dict[str, str]]:
            content = coordinator.merged.image(run, wanted, k, RENDERED_AS[image_format], sigma=sigma)
            return raw_from_npy(content) if image_format is ImageFormat.RAW else (content, {})

        content, headers = await services.pictures.ask(picture)
        # Other flat fields give other pictures of the same run.
        return conditional_response(request, content, MEDIA_TYPES[image_format], cache=REVALIDATE, headers=headers)

    return routes


def _entry(k: int, choice: MergedChoice, url: str) -> MergedEntry:
    return MergedEntry(k=k, url=url, **merged_entry(choice))
