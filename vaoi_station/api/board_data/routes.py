"""Routes under `board-data`: upload, preview, correct and confirm."""

from __future__ import annotations

import re
from contextlib import suppress
from typing import Annotated
from urllib.parse import quote

from fastapi import APIRouter, Path, Query, Request, Response

from vaoi_station.api.board_data.models import (
    ImportOptions,
    ImportPreview,
    ImportPreviewList,
    UploadOptions,
)
from vaoi_station.api.board_data.previews import Preview, Previews
from vaoi_station.api.http_caching import REVALIDATE, conditional_response
from vaoi_station.api.limits import Seats, ThreadLimit, caller_in
from vaoi_station.api.parameters import IfMatch, IfNoneMatch, rest_router
from vaoi_station.api.rest_models import PREVIEW_ID
from vaoi_station.api.routes.board_types import document_of, unchanged_board_type
from vaoi_station.api.routes.services import Services
from vaoi_station.errors import InputError, NotFoundError
from vaoi_station.model import BoardType
from vaoi_station.model.board_type import STORED_NAME, STORED_NAME_RULE

PreviewId = Annotated[str, Path(description="Id of a preview.", pattern=PREVIEW_ID)]
BODY = {
    "requestBody": {
        "required": True,
        "content": {"application/octet-stream": {"schema": {"type": "string", "format": "binary"}}},
    }
}
"""OpenAPI description of an upload."""
_SVG_POLICY = "default-src 'none'; style-src 'unsafe-inline'; sandbox"


def router(services: Services, previews: Previews) -> APIRouter:
    """Create the routes for imports of board data."""
    routes = rest_router(prefix="/board-data", tags=["board types"])
    # One import at a time: each may take a whole core and much memory. Confirming does not wait for it.
    importing, checking, quick = ThreadLimit(1), ThreadLimit(1), services.commands
    seats = Seats("imports of board data", 6, 3)

    def document(request: Request, preview: Preview) -> ImportPreview:
        return previews.document(preview, f"{_prefix(request)}/board-data/previews")

    @routes.get("/previews")
    async def list_import_previews(request: Request) -> ImportPreviewList:
        """List the uploaded files and what they would make."""
        found = await quick.ask(previews.list)
        return ImportPreviewList(previews=[document(request, preview) for preview in found])

    @routes.post("/previews", status_code=201, openapi_extra=BODY)
    async def upload_board_data(
        request: Request, response: Response, upload: Annotated[UploadOptions, Query()]
    ) -> ImportPreview:
        """Upload a file of a CAD system or placement machine, and return what board type it would make.

        The body is the file as it is: KiCad, GenCAD, IPC-2581, ODB++ (zip, tgz), EAGLE, InteractiveHtmlBom, or a
        centroid file. Nothing is stored until the preview is confirmed.
        """
        with seats.take(caller_in(request.scope).name):
            with previews.uploading(upload.filename) as (file, path):
                empty = True
                async for piece in request.stream():
                    await quick.ask(file.write, piece)
                    empty = empty and not piece
                if empty:
                    raise InputError("body: is empty, but must be the file.")
            options = ImportOptions.model_validate(upload.model_dump(exclude={"filename"}))
            preview = await importing.ask(previews.add, path, options)
        response.headers["Location"] = f"{request.url.path}/{preview.id}"
        return document(request, preview)

    @routes.get("/previews/{preview}")
    async def get_import_preview(request: Request, preview: PreviewId) -> ImportPreview:
        """Return what an uploaded file would make."""
        return document(request, await quick.ask(previews.get, preview))

    @routes.put("/previews/{preview}")
    async def correct_import_preview(request: Request, preview: PreviewId, options: ImportOptions) -> ImportPreview:
        """Import an uploaded file again with other options: side, columns, units, or joined with another file."""
        with seats.take(caller_in(request.scope).name):
            return document(request, await importing.ask(previews.change, preview, options))

    @routes.delete("/previews/{preview}", status_code=204)
    async def delete_import_preview(preview: PreviewId) -> None:
        """Delete an uploaded file and its preview."""
        await quick.ask(previews.drop, preview)

    @routes.get(
        "/previews/{preview}/picture",
        response_class=Response,
        responses={200: {"description": "The picture.", "content": {"image/svg+xml": {"schema": {"type": "string"}}}}},
    )
    async def get_import_picture(preview: PreviewId) -> Response:
        """Return outline, cut-outs, marks and bodies of a preview as SVG. Bodies of guessed size are orange."""
        reply = await quick.ask(previews.reply, preview)
        headers = {"Content-Security-Policy": _SVG_POLICY}
        return Response(reply.picture, media_type="image/svg+xml", headers=headers)

    @routes.get("/previews/{preview}/board-type", response_model=BoardType)
    async def get_imported_board_type(preview: PreviewId) -> Response:
        """Return the board type that a preview would make."""
        reply = await quick.ask(previews.reply, preview)
        return Response(reply.board_type, media_type="application/json")

    @routes.post(
        "/previews/{preview}/confirm",
        response_model=BoardType,
        responses={201: {"model": BoardType, "description": "New."}},
    )
    async def confirm_import(
        request: Request, preview: PreviewId, _: IfMatch = None, __: IfNoneMatch = None
    ) -> Response:
        """Store the board type of a preview, as `PUT board-types/{name}` does, and delete the preview.

        With `If-None-Match: *` it replaces no board type, with `If-Match: ETAG` only the version that the caller has
        read: else 412 `changed`, and the preview stays. Without, one of the same name is replaced, as before.
        """
        reply = await quick.ask(previews.reply, preview)
        board_type = await checking.ask(BoardType.model_validate_json, reply.board_type)
        content = await checking.ask(document_of, board_type)
        if not re.fullmatch(STORED_NAME, board_type.name):
            action = "Set `name` by PUT of the preview."
            raise InputError.field("preview", "name", board_type.name, STORED_NAME_RULE, action=action)
        answer = conditional_response(request, content, "application/json", cache=REVALIDATE)
        async with unchanged_board_type(services, request, board_type.name):
            if await quick.ask(services.coordinator.put_board_type, board_type):
                answer.status_code = 201
                answer.headers["Location"] = f"{_prefix(request)}/board-types/{quote(board_type.name)}"
        with suppress(NotFoundError):  # deleted meanwhile: by another caller, or because others are newer
            await quick.ask(previews.drop, preview)
        return answer

    return routes


def _prefix(request: Request) -> str:
    return request.url.path.partition("/board-data")[0]
