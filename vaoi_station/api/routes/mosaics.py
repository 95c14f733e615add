"""Routes under `runs/{id}/mosaics`: the whole board as tiles that viewers of large pictures read, and as a file."""

from __future__ import annotations

import re
import tempfile
from pathlib import Path as File
from typing import Annotated, Literal
from urllib.parse import quote

from fastapi import APIRouter, Depends, Path, Query, Request, Response
from fastapi.responses import FileResponse
from starlette.background import BackgroundTask
from starlette.datastructures import Headers
from starlette.types import Receive, Scope, Send

from vaoi_station.api.http_caching import REVALIDATE, conditional_response, json_response
from vaoi_station.api.limits import Seats
from vaoi_station.api.parameters import MOSAIC_NAME, RunId, file_reply, rest_router
from vaoi_station.api.rest_models import KeptMosaicEntry, MosaicEntry, MosaicList
from vaoi_station.api.routes.services import Services
from vaoi_station.errors import InputError
from vaoi_station.files.images import narrowed_jpeg
from vaoi_station.mosaic.grid import dzi_document, dzi_reduction, levels_of, tile_box
from vaoi_station.runs.mosaics.mosaics import Download
from vaoi_station.runs.mosaics.opened_mosaics import parse_name

Picture = Annotated[
    str,
    Path(
        description="Name of a mosaic: `board`, with `,light=NAME`, `,exposure=µs` or `,hdr` added.",
        pattern=MOSAIC_NAME,
    ),
]
Side = Annotated[int, Path(ge=0, le=10_000_000)]
FILES, FILES_OF_CALLER = 2, 1
"""Limits of files of whole boards, in all and of one caller, that are being made or have not been read yet."""
LARGE_FILES = File("/var/tmp")  # noqa: S108  each file is in a directory of its own, with mode 0700
MEDIA = {"jpg": "image/jpeg", "png": "image/png"}
TIFF = file_reply("A tiled, pyramidal TIFF.", "image/tiff")
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
    mosaics, kept = services.coordinator.mosaics, services.coordinator.kept.mosaics
    ask, seat = services.commands.ask, Depends(services.picture_seats.hold)
    # One takes a worker for minutes, and over a gigabyte of the disk.
    files = Seats("files of whole boards that are made or read", FILES, FILES_OF_CALLER)

    @routes.get("", response_model=MosaicList)
    async def list_mosaics(request: Request, run: RunId) -> Response:
        """List the mosaics of a run: one for each light, for each exposure, and merged of all exposures (HDR)."""
        address = quote(request.url.path)

        def listed() -> MosaicList:
            small = kept.grid(run)
            entries = []
            for name in mosaics.names(run):
                grid, file = mosaics.grid(run, name), f"{address}/{quote(str(name))}"
                entries.append(
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
                        dzi=f"{file}.dzi",
                        tiff=f"{file}.tif",
                    )
                )
            picture = small and KeptMosaicEntry(
                width_px=small.width,
                height_px=small.height,
                px_per_mm=small.px_per_mm,
                image_from_cad=small.mosaic_from_cad.tolist(),
                url=f"{address}/kept.jpg",
            )
            return MosaicList(mosaics=entries, kept=picture)

        # The small picture is made later, and deleted before the run.
        return json_response(request, await ask(listed), REVALIDATE)

    @routes.get(
        "/kept.jpg",
        response_class=Response,
        responses=file_reply("The picture.", "image/jpeg"),
        dependencies=[seat],
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
        content = await ask(lambda: kept.content(run) if width is None else narrowed_jpeg(kept.content(run), width))
        return conditional_response(request, content, "image/jpeg")

    @routes.get(
        "/{picture}.dzi",
        response_class=Response,
        responses={
            200: {"description": "The .dzi file.", "content": {"application/xml": {"schema": {"type": "string"}}}}
        },
    )
    async def get_dzi(request: Request, run: RunId, picture: Picture) -> Response:
        """Return the description of a mosaic as a Deep Zoom Image, whose tiles are JPEG."""
        grid = await ask(mosaics.grid, run, parse_name(picture))
        return conditional_response(request, dzi_document(grid, "jpg").encode(), "application/xml")

    @routes.get(
        "/{picture}_files/{level}/{column}_{row}.{suffix}",
        response_class=Response,
        responses=file_reply("The tile.", *MEDIA.values()),
        dependencies=[seat],
    )
    async def get_dzi_tile(
        *,
        request: Request,
        run: RunId,
        picture: Picture,
        level: Annotated[int, Path(description="Level of DZI; the last one is the largest.", ge=0, le=40)],
        column: Annotated[Side, Path(description="Column of the tile, from 0.")],
        row: Annotated[Side, Path(description="Row of the tile, from 0.")],
        suffix: Annotated[Literal["jpg", "jpeg", "png"], Path(description="Format of the tile.")],
    ) -> Response:
        """Return one tile of a Deep Zoom Image, 256 × 256 px or less. 410: the frames are no longer in memory."""
        name, format = parse_name(picture), "png" if suffix == "png" else "jpg"

        def tile() -> bytes:
            grid = mosaics.grid(run, name)
            reduction = dzi_reduction(grid, level)
            return mosaics.tile(run, name, reduction, tile_box(grid.reduced(reduction), column, row), format)

        # Other flat fields give other pixels of the same run.
        return conditional_response(request, await services.pictures.ask(tile), MEDIA[format], cache=REVALIDATE)

    @routes.get(
        "/{picture}.tif",
        response_class=FileResponse,
        responses={**TIFF, 206: {**TIFF[200], "description": "The bytes of the header Range."}},
        # A refusal comes before the wait for a seat for pictures.
        dependencies=[Depends(files.hold), seat],
    )
    async def download_mosaic(
        run: RunId,
        picture: Picture,
        x0: Annotated[float | None, Query(description="Corner of a region, CAD; all four or none.")] = None,
        y0: Annotated[float | None, Query(description="The same corner, y.")] = None,
        x1: Annotated[float | None, Query(description="The opposite corner, x.")] = None,
        y1: Annotated[float | None, Query(description="The opposite corner, y.")] = None,
        px_per_mm: Annotated[
            float | None, Query(description="Resolution; default: that of the cameras.", ge=0.1, le=500)
        ] = None,
    ) -> Response:
        """Return a mosaic, or a region of it, as one file, at most 300 megapixels. The header Range selects bytes.

        It is sent when it is complete. 503 `disk-full`: the disk has no room for it; 503 `busy`: another file of more
        than 64 megapixels is being made.
        """
        given = [value for value in (x0, y0, x1, y1) if value is not None]
        if len(given) not in (0, 4):
            limit = "given with all four coordinates, or with none"
            raise InputError.field("mosaic", "region", f"{len(given)} of x0, y0, x1, y1", limit)
        region = (given[0], given[1], given[2], given[3]) if given else None
        name = parse_name(picture)
        # Not /tmp, which is memory on Debian 13: the file may be larger than a gigabyte.
        folder = tempfile.TemporaryDirectory(prefix="vaoi-mosaic-", dir=LARGE_FILES if LARGE_FILES.is_dir() else None)
        path = File(folder.name) / "mosaic.tif"
        try:
            await services.pictures.ask(mosaics.write, run, name, Download(region, px_per_mm), path)
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
