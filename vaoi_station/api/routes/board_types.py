"""Routes under `board-types`: store, read and delete board types."""

from __future__ import annotations

import json
from urllib.parse import quote

from fastapi import APIRouter, Request, Response
from fastapi.exceptions import RequestValidationError
from pydantic import ValidationError

from vaoi_station.api.http_caching import LIVE, REVALIDATE, conditional_response, require_unchanged
from vaoi_station.api.limits import ThreadLimit
from vaoi_station.api.parameters import BoardTypeName, IfMatch, IfNoneMatch, Revision, rest_router
from vaoi_station.api.rest_models import BoardTypeList, BoardTypeVersions, StateRequest
from vaoi_station.api.routes.services import Services
from vaoi_station.errors import InputError, NotFoundError, VaoiError
from vaoi_station.model import BoardType

BODY = {
    "requestBody": {
        "required": True,
        "content": {"application/json": {"schema": {"$ref": "#/components/schemas/BoardType"}}},
    }
}
"""OpenAPI description of the request body with which a board type is stored."""


def router(services: Services) -> APIRouter:
    """Create the routes for board types. Their documents have the format of `docs/formats.md`."""
    routes = rest_router(prefix="/board-types", tags=["board types"])
    coordinator, ask = services.coordinator, services.commands.ask
    # Only one is parsed at a time, because parsing holds the interpreter's lock.
    parsing = ThreadLimit(1)
    # Between the check of If-Match and the change no other caller may change the board type.
    changing = services.changing

    @routes.get("", response_model_exclude_none=True)
    async def list_board_types(response: Response) -> BoardTypeList:
        """List all board types, sorted by name. The entry of an unusable file states the fault."""
        response.headers["Cache-Control"] = REVALIDATE
        known, deleted = await ask(coordinator.board_types), await ask(coordinator.board_type_history.deleted)
        return BoardTypeList(board_types=list(known), deleted=list(deleted))

    @routes.get("/{name}", response_model=BoardType)
    async def get_board_type(request: Request, name: BoardTypeName) -> Response:
        """Return the stored document of one board type."""
        content = document_of(await ask(coordinator.board_type, name))
        return conditional_response(request, content, "application/json", cache=REVALIDATE)

    @routes.put(
        "/{name}",
        response_model=BoardType,
        responses={201: {"model": BoardType, "description": "New."}},
        openapi_extra=BODY,
    )
    async def put_board_type(
        request: Request, name: BoardTypeName, _: IfMatch = None, __: IfNoneMatch = None
    ) -> Response:
        """Store a board type, or replace it; the version before can be restored.

        Finished runs keep the version they were filmed with, and an armed line keeps its version as well; the new one
        applies from the next arming on. With `If-Match: ETAG` it replaces only the version that the caller has read,
        with `If-None-Match: *` none: else 412 `changed`.
        """
        # The board type is not a parameter of the route: FastAPI would check its contents in the event loop, which
        # takes long.
        board_type = await parsing.ask(_parsed, await request.body())
        if board_type.name != name:
            raise InputError.field("body", "name", board_type.name, f"{name!r}, as in the address")
        content = document_of(board_type)
        async with changing:
            require_unchanged(request, await present_document(services, request, name), f"Board type {name!r}")
            new = await ask(coordinator.put_board_type, board_type)
        answer = conditional_response(request, content, "application/json", cache=REVALIDATE)
        if new:
            answer.status_code = 201
            answer.headers["Location"] = quote(request.url.path)
        return answer

    @routes.delete("/{name}", status_code=204)
    async def delete_board_type(request: Request, name: BoardTypeName, _: IfMatch = None) -> None:
        """Delete a board type, of which a version is kept. Refused with 409 while the station is armed with it.

        With `If-Match: ETAG` only the version that the caller has read: else 412 `changed`.
        """
        async with changing:
            require_unchanged(request, await present_document(services, request, name), f"Board type {name!r}")
            await ask(coordinator.delete_board_type, name)

    @routes.put("/{name}/state", response_model=BoardType)
    async def set_board_type_state(
        request: Request, name: BoardTypeName, body: StateRequest, _: IfMatch = None
    ) -> Response:
        """Set the state of a board type, and its revision if given. The version before can be restored.

        An armed line keeps the state with which it was armed; the new one applies from the next arming on. With
        `If-Match: ETAG` only the version that the caller has read: else 412 `changed`.
        """
        async with changing:
            require_unchanged(request, await present_document(services, request, name), f"Board type {name!r}")
            board_type = await ask(coordinator.board_type_history.set_state, name, body.state, body.revision)
        return conditional_response(request, document_of(board_type), "application/json", cache=LIVE)

    @routes.get("/{name}/revisions")
    async def list_revisions(response: Response, name: BoardTypeName) -> BoardTypeVersions:
        """List the versions of a board type that were replaced or deleted, newest first."""
        response.headers["Cache-Control"] = LIVE
        return BoardTypeVersions(revisions=list(await ask(coordinator.board_type_history.list, name)))

    @routes.get("/{name}/revisions/{revision}", response_model=BoardType)
    async def get_revision(name: BoardTypeName, revision: Revision) -> Response:
        """Return the document of one version."""
        content = document_of(await ask(coordinator.board_type_history.get, name, revision))
        return Response(content, media_type="application/json", headers={"Cache-Control": LIVE})

    @routes.post("/{name}/revisions/{revision}/restore", response_model=BoardType)
    async def restore_revision(
        request: Request, name: BoardTypeName, revision: Revision, _: IfMatch = None
    ) -> Response:
        """Put a version in force again, from the next arming on. The present one becomes a version itself.

        The reference and the method of a board type that was deleted have to be set again.
        """
        async with changing:
            require_unchanged(request, await present_document(services, request, name), f"Board type {name!r}")
            content = document_of(await ask(coordinator.board_type_history.restore, name, revision))
        return Response(content, media_type="application/json", headers={"Cache-Control": LIVE})

    return routes


def _parsed(body: bytes) -> BoardType:
    """Parse a board type; raise the same errors as FastAPI does for a body."""
    if not body:
        raise RequestValidationError([{"type": "missing", "loc": ("body",), "msg": "Field required", "input": None}])
    try:
        return BoardType.model_validate(json.loads(body))
    except json.JSONDecodeError as error:
        fault = {"type": "json_invalid", "loc": ("body", error.pos), "msg": "JSON decode error", "input": {}}
        raise RequestValidationError([{**fault, "ctx": {"error": error.msg}}]) from error
    except (ValueError, RecursionError) as error:
        faults = error.errors() if isinstance(error, ValidationError) else [{"type": "json_invalid", "msg": str(error)}]
        raise RequestValidationError([{**f, "loc": ("body", *f.get("loc", ()))} for f in faults]) from error


async def present_document(services: Services, request: Request, name: str) -> bytes | None:
    """Return the document of a board type as it is now; None if there is none, or the request has no condition."""
    if not {"if-match", "if-none-match"} & set(request.headers.keys()):
        return None
    try:
        return await services.commands.ask(lambda: document_of(services.coordinator.board_type(name)))
    except NotFoundError:
        return None
    except VaoiError:
        return b""  # there is a file, which cannot be used: no caller has read it


def document_of(board_type: BoardType) -> bytes:
    """Return the document of a board type, of which its ETag is made."""
    try:
        return json.dumps(board_type.model_dump(exclude_none=True), allow_nan=False).encode()
    except ValueError as error:
        raise InputError(f"body: {error}; JSON has neither NaN nor infinity.") from error
