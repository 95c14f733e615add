"""Routes under `runs/{id}/frames/{camera}/{row}`: frames as the cameras delivered them."""

from __future__ import annotations

from typing import Annotated, Any, Literal

from fastapi import APIRouter, Depends, Header, Query, Request, Response

from vaoi_station.api.encoders import MEDIA_TYPES, choose_format, encode_image
from vaoi_station.api.http_caching import conditional_response
from vaoi_station.api.images.byte_ranges import part_of
from vaoi_station.api.parameters import Camera, FormatName, Row, RunId, rest_router
from vaoi_station.api.routes.services import Services

Accept = Annotated[str | None, Header(max_length=500)]
PICTURE: dict[int | str, dict[str, Any]] = {
    200: {
        "description": "The image; X-Image-* headers describe raw pixels.",
        "content": {media: {"schema": {"type": "string", "format": "binary"}} for media in MEDIA_TYPES.values()},
    }
}


def router(services: Services) -> APIRouter:
    """Create the route for frames."""
    routes = rest_router(prefix="/runs/{run}/frames", tags=["pictures"])

    @routes.get(
        "/{camera}/{row}",
        response_class=Response,
        responses={**PICTURE, 206: {**PICTURE[200], "description": "The bytes of the header Range."}},
        dependencies=[Depends(services.picture_seats.hold)],
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
            pixels, record = services.coordinator.frame(run, camera, row, incomplete == "show")
            content, headers = encode_image(pixels, image_format)
            return content, headers | {"X-Frame-Verdict": str(record.verdict) if record.proven else "unproven"}

        content, headers = await services.pictures.ask(picture)
        whole = conditional_response(request, content, MEDIA_TYPES[image_format], headers=headers)
        return part_of(request, whole)

    return routes
