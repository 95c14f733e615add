"""Routes under `runs/{id}/mosaics`: the whole board as tiles that viewers of large pictures read, and as a file."""

from __future__ import annotations

import json
import re
import tempfile
from pathlib import Path as File
from typing import Annotated, Any, Literal
from urllib.parse import quote

from fastapi import APIRouter, Depends, Path, Query, Request, Response
from fastapi.responses import FileResponse
from starlette.background import BackgroundTask
from starlette.datastructures import Headers
from starlette.types import Receive, Scope, Send

from vaoi_station.api.http_caching import IMMUTABLE, REVALIDATE, conditional_response
from vaoi_station.api.limits import file_seats
from vaoi_station.api.parameters import MOSAIC_NAME, RunId, rest_router
from vaoi_station.api.rest_models import KeptMosaicEntry, MosaicEntry, MosaicList
from vaoi_station.api.routes.services import Services
from vaoi_station.errors import InputError
from vaoi_station.files.images import narrowed_jpeg
from vaoi_station.mosaic.deep_zoom import (
    dzi_document,
    dzi_reduction,
    iiif_document,
    iiif_tile,
    levels_of,
    tile_box,
)
from vaoi_station.runs.mosaics.mosaics import Download
from vaoi_station.runs.mosaics.picture_names import parse_name

Picture = Annotated[
    str,
    Path(
        description="Name of a mosaic: `board`, with `,light=NAME`, `,exposure=µs` or `,hdr` added.",
        pattern=MOSAIC_NAME,
    ),
]
Suffix = Literal["jpg", "jpeg", "png"]
Side = Annotated[int, Path(ge=0, le=10_000_000)]
LARGE_FILES = File("/var/tmp")  # noqa: S108  each file is in a directory of its own, with mode 0700
MEDIA = {"jpg": "image/jpeg", "png": "image/png"}
TILE: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The tile.",
        "content": {media: {"schema": {"type": "string", "format": "binary"}} for media in MEDIA.values()},
    }
}
FILE: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "A tiled, pyramidal TIFF.",
        "content": {"image/tiff": {"schema": {"type": "string", "format": "binary"}}},
    },
    206: {
        "description": "The bytes of the header Range.",
        "content": {"image/tiff": {"schema": {"type": "string", "format": "binary"}}},
    },
}
KEPT: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The picture.",
        "content": {"image/jpeg": {"schema": {"type": "string", "format": "binary"}}},
    }
}
DZI: dict[int | str, dict[str, Any]] = {
    200: {"description": "The .dzi file.", "content": {"application/xml": {"schema": {"type": "string"}}}}
}
IIIF: dict[int | str, dict[str, Any]] = {
    200: {"description": "The info.json.", "content": {"application/json": {"schema": {"type": "object"}}}}
}


_RANGE = re.compile(r"bytes=(\d{1,15})-(\d{0,15})")


class MosaicFile(FileResponse):
    """The file of a mosaic, or one range of its bytes. Any other header Range is ignored, as RFC 9110 permits."""

    async def __call__(self, scope: Scope, receive: Receive, send: Send) -> None:
        """Send the file."""
        # Starlette refuses a range that it cannot read, or that is beyond the end, in plain text.
        asked = _RANGE.fullmatch(Headers(scope=scope).get("range", ""))
        size = File(self.path).stat().st_size
        if asked is None or not int(asked[1]) <= int(asked[2] or size) or int(asked[1]) >= size:
            scope = {**scope, "headers": [(name, value) for name, value in scope["headers"] if name != b"range"]}
        await super().__call__(scope, receive, send)


def router(services: Services) -> APIRouter:
    """Create the routes for mosaics."""
    routes = rest_router(prefix="/runs/{run}/mosaics", tags=["pictures"])
    mosaics, ask, files = services.coordinator.mosaics, services.commands.ask, file_seats()

    async def tile(request: Request, run: str, picture: str, suffix: str, make: Any) -> Response:
        name, format = parse_name(picture), "png" if suffix == "png" else "jpg"

        def rendered() -> bytes:
            reduction, box = make(mosaics.grid(run, name))
            return mosaics.tile(run, name, reduction, box, format)

        content = await services.pictures.ask(rendered)
        # Other flat fields give other pixels of the same run.
        return conditional_response(request, content, MEDIA[format], cache=REVALIDATE)

    @routes.get("", response_model=MosaicList)
    async def list_mosaics(request: Request, run: RunId) -> Response:
        """List the mosaics of a run: one for each light, for each exposure, and merged of all exposures (HDR)."""

        def entries() -> MosaicList:
            found = []
            for name in mosaics.names(run):
                grid, address = mosaics.grid(run, name), f"{quote(request.url.path)}/{quote(str(name))}"
                found.append(
                    MosaicEntry(
                        name=str(name),
                        light=name.light,
                        exposure_us=name.exposure_us,
                        hdr=name.hdr,
                        width_px=grid.width,
                        height_px=grid.height,
                        px_per_mm=grid.px_per_mm,
                        levels=levels_of(grid),
                        image_from_cad=grid.mosaic_from_cad.tolist(),
                        dzi=f"{address}.dzi",
                        iiif=f"{address}/info.json",
                        tiff=f"{address}.tif",
                    )
                )
            return MosaicList(mosaics=found, kept=_kept(services, run, f"{quote(request.url.path)}/kept.jpg"))

        body = (await ask(entries)).model_dump_json(exclude_none=True).encode()
        # The small picture is made later, and deleted before the run.
        return conditional_response(request, body, "application/json", cache=REVALIDATE)

    @routes.get(
        "/kept.jpg",
        response_class=Response,
        responses=KEPT,
        dependencies=[Depends(services.picture_seats.hold)],
    )
    async def get_kept_mosaic(
        request: Request,
        run: RunId,
        width: Annotated[
            int | None, Query(description="Largest width, px, for lists; default: as it is kept.", ge=16, le=10_000)
        ] = None,
    ) -> Response:
        """Return the small picture of the whole board that is kept when the frames are gone, at most 2 megapixels.

        The station makes it in spare time after a run, within `[keep] mosaics_gb`. 404 `no-kept-mosaic`: there is none.
        """

        def picture() -> bytes:
            content = services.coordinator.kept.mosaics.content(run)
            return content if width is None else narrowed_jpeg(content, width)

        content = await ask(picture)
        return conditional_response(request, content, MEDIA["jpg"], cache=IMMUTABLE)

    @routes.get("/{picture}.dzi", response_class=Response, responses=DZI)
    async def get_dzi(request: Request, run: RunId, picture: Picture) -> Response:
        """Return the description of a mosaic as a Deep Zoom Image, whose tiles are JPEG."""
        grid = await ask(mosaics.grid, run, parse_name(picture))
        return conditional_response(request, dzi_document(grid, "jpg").encode(), "application/xml")

    @routes.get(
        "/{picture}_files/{level}/{column}_{row}.{suffix}",
        response_class=Response,
        responses=TILE,
        dependencies=[Depends(services.picture_seats.hold)],
    )
    async def get_dzi_tile(
        *,
        request: Request,
        run: RunId,
        picture: Picture,
        level: Annotated[int, Path(description="Level of DZI; the last one is the largest.", ge=0, le=40)],
        column: Side,
        row: Side,
        suffix: Suffix,
    ) -> Response:
        """Return one tile of a Deep Zoom Image, 256 × 256 px or less. 410: the frames are no longer in memory."""

        def place(grid: Any) -> Any:
            reduction = dzi_reduction(grid, level)
            return reduction, tile_box(grid.reduced(reduction), column, row)

        return await tile(request, run, picture, suffix, place)

    @routes.get("/{picture}/info.json", response_class=Response, responses=IIIF)
    async def get_iiif(request: Request, run: RunId, picture: Picture) -> Response:
        """Return the description of a mosaic for the IIIF Image API 3, level 0."""
        grid = await ask(mosaics.grid, run, parse_name(picture))
        address = str(request.url.replace(query="")).removesuffix("/info.json")
        body = json.dumps(iiif_document(grid, address), indent=1).encode()
        return conditional_response(request, body, "application/json")

    @routes.get(
        "/{picture}/{region}/{size}/0/default.{suffix}",
        response_class=Response,
        responses=TILE,
        dependencies=[Depends(services.picture_seats.hold)],
    )
    async def get_iiif_tile(
        *,
        request: Request,
        run: RunId,
        picture: Picture,
        region: Annotated[str, Path(max_length=50)],
        size: Annotated[str, Path(max_length=30)],
        suffix: Suffix,
    ) -> Response:
        """Return one tile of the IIIF Image API 3: a region and size that info.json lists."""
        return await tile(request, run, picture, suffix, lambda grid: iiif_tile(grid, region, size))

    @routes.get(
        "/{picture}.tif",
        response_class=FileResponse,
        responses=FILE,
        # A refusal comes before the wait for a seat for pictures.
        dependencies=[Depends(files.hold), Depends(services.picture_seats.hold)],
    )
    async def download_mosaic(
        run: RunId,
        picture: Picture,
        x0: Annotated[float | None, Query(description="Corner of a region, CAD; all four or none.")] = None,
        y0: float | None = None,
        x1: float | None = None,
        y1: float | None = None,
        px_per_mm: Annotated[
            float | None, Query(description="Resolution; default: that of the cameras.", ge=0.1, le=500)
        ] = None,
    ) -> Response:
        """Return a mosaic, or a region of it, as one file, at most 300 megapixels. The header Range selects bytes.

        It is sent when it is complete. 503 `disk-full`: the disk has no room for it; 503 `busy`: another file of more
        than 64 megapixels is being made.
        """
        name, download = parse_name(picture), _download((x0, y0, x1, y1), px_per_mm)
        # Not /tmp, which is memory on Debian 13: the file may be larger than a gigabyte.
        folder = tempfile.TemporaryDirectory(prefix="vaoi-mosaic-", dir=LARGE_FILES if LARGE_FILES.is_dir() else None)
        path = File(folder.name) / "mosaic.tif"
        try:
            await services.pictures.ask(mosaics.write, run, name, download, path)
        except BaseException:  # also if the caller has gone: the folder must not stay
            folder.cleanup()
            raise
        return MosaicFile(
            path,
            media_type="image/tiff",
            filename=f"{run}-{name}.tif",
            headers={"Cache-Control": REVALIDATE},
            background=BackgroundTask(folder.cleanup),
        )

    return routes


def _kept(services: Services, run: str, url: str) -> KeptMosaicEntry | None:
    """Return the entry of the kept picture of a run; None if none is kept."""
    grid = services.coordinator.kept.mosaics.grid(run)
    if grid is None:
        return None
    matrix = grid.mosaic_from_cad.tolist()
    return KeptMosaicEntry(
        width_px=grid.width, height_px=grid.height, px_per_mm=grid.px_per_mm, image_from_cad=matrix, url=url
    )


def _download(corners: tuple[float | None, ...], px_per_mm: float | None) -> Download:
    """Check that a region has all four coordinates or none."""
    given = [value for value in corners if value is not None]
    if len(given) not in (0, 4):
        raise InputError.field(
            "mosaic", "region", f"{len(given)} of x0, y0, x1, y1", "given with all four coordinates, or with none"
        )
    region = (given[0], given[1], given[2], given[3]) if given else None
    return Download(region, px_per_mm)
