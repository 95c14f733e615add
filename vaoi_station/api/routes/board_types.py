"""Routes under `board-types`: documents and versions, reference, method, light program, and the check against a run."""

from __future__ import annotations

import asyncio
import json
from collections.abc import AsyncIterator, Callable
from contextlib import asynccontextmanager
from functools import partial
from typing import Annotated, TypeVar
from urllib.parse import quote

from fastapi import APIRouter, Depends, Query, Request, Response
from fastapi.exceptions import RequestValidationError
from pydantic import Field, ValidationError

from vaoi_station.api.http_caching import (
    LIVE,
    REVALIDATE,
    conditional_response,
    json_response,
    require_unchanged,
    tag_of,
)
from vaoi_station.api.limits import ThreadLimit
from vaoi_station.api.parameters import BoardTypeName, IfMatch, IfNoneMatch, Revision, RunId, file_reply, rest_router
from vaoi_station.api.rest_models import (
    BoardTypeList,
    BoardTypeVersions,
    CorrectionRequest,
    MethodRequest,
    StateRequest,
    TeachRequest,
)
from vaoi_station.api.routes.services import Services
from vaoi_station.board_check.report import BoardCheck
from vaoi_station.errors import InputError, NotFoundError, VaoiError
from vaoi_station.model import BoardLimits, BoardType, Strict
from vaoi_station.model.recording import Program
from vaoi_station.runs.lighting.programs import ProgramCheck
from vaoi_station.runs.states.schemas import GoodBoards, LimitsReport, ReferenceStatus, StitchingMethod
from vaoi_station.store.run_search import RunFilter

BODY = {
    "requestBody": {
        "required": True,
        "content": {"application/json": {"schema": {"$ref": "#/components/schemas/BoardType"}}},
    }
}
"""OpenAPI description of the request body with which a board type is stored."""
_LATEST_RUNS = 200
"""Number of runs whose measures are compared with limits that are set."""
Setting = TypeVar("Setting", StitchingMethod, ReferenceStatus)
Checked = Annotated[
    str | None,
    Query(description="Name of the board type that is checked [that of the run].", min_length=1, max_length=200),
]


class ProgramRequest(Strict):
    """A light program that is to be checked."""

    program: Program | None = Field(
        default=None,
        description="The steps, as in a board type; empty: those of the station; absent: those in force.",
    )


def router(services: Services) -> APIRouter:
    """Create the routes. Documents of board types have the format of `docs/formats.md`."""
    routes = rest_router(prefix="/board-types", tags=["board types"])
    coordinator, ask, history = services.coordinator, services.commands.ask, services.coordinator.board_type_history
    # Only one is parsed at a time, because parsing holds the interpreter's lock.
    parsing = ThreadLimit(1)

    def shown(request: Request, board_type: BoardType, cache: str = LIVE) -> Response:
        return json_response(request, document_of(board_type), cache)

    @routes.get("")
    async def list_board_types(response: Response) -> BoardTypeList:
        """List all board types, sorted by name. The entry of an unusable file states the fault."""
        response.headers["Cache-Control"] = REVALIDATE
        known, deleted = await ask(coordinator.board_types), await ask(history.deleted)
        return BoardTypeList(board_types=list(known), deleted=list(deleted))

    @routes.get("/{name}", response_model=BoardType)
    async def get_board_type(request: Request, name: BoardTypeName) -> Response:
        """Return the stored document of one board type."""
        return shown(request, await ask(coordinator.board_type, name), REVALIDATE)

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
        answer = shown(request, board_type, REVALIDATE)
        async with unchanged_board_type(services, request, name):
            if await ask(coordinator.put_board_type, board_type):
                answer.status_code, answer.headers["Location"] = 201, quote(request.url.path)
        return answer

    @routes.delete("/{name}", status_code=204)
    async def delete_board_type(request: Request, name: BoardTypeName, _: IfMatch = None) -> None:
        """Delete a board type, of which a version is kept. Refused with 409 while the station is armed with it.

        With `If-Match: ETAG` only the version that the caller has read: else 412 `changed`.
        """
        async with unchanged_board_type(services, request, name):
            await ask(coordinator.delete_board_type, name)

    @routes.put("/{name}/state", response_model=BoardType)
    async def set_board_type_state(
        request: Request, name: BoardTypeName, body: StateRequest, _: IfMatch = None
    ) -> Response:
        """Set the state of a board type, and its revision if given. The version before can be restored.

        An armed line keeps the state with which it was armed; the new one applies from the next arming on. With
        `If-Match: ETAG` only the version that the caller has read: else 412 `changed`.
        """
        async with unchanged_board_type(services, request, name):
            return shown(request, await ask(history.set_state, name, body.state, body.revision))

    @routes.get("/{name}/limits")
    async def get_limits(name: BoardTypeName) -> BoardLimits:
        """Return the limits beyond which measures of parts are marked; without any, none are."""
        return (await ask(coordinator.board_type, name)).limits or BoardLimits()

    @routes.put("/{name}/limits", dependencies=[Depends(services.search_seats.hold)])
    async def set_limits(request: Request, name: BoardTypeName, body: BoardLimits, _: IfMatch = None) -> LimitsReport:
        """Set the limits of the parts of a board type, and return what they would have marked on the latest boards.

        They mark and judge nothing: no verdict changes. Measures that are stored keep their marks; the new limits apply
        from the next arming on. The version before can be restored. With `If-Match: ETAG` (of the board type) only if
        it is still the one that the caller has read: else 412 `changed`.
        """
        async with unchanged_board_type(services, request, name):
            board_type, report = await marked_by(name, body)
            await ask(history.set_limits, board_type, body)
        return report

    @routes.post("/{name}/limits/check", dependencies=[Depends(services.search_seats.hold)])
    async def check_limits(name: BoardTypeName, body: BoardLimits) -> LimitsReport:
        """Return what limits would have marked on the latest boards, by their stored measures. Nothing is changed."""
        return (await marked_by(name, body))[1]

    async def marked_by(name: str, limits: BoardLimits) -> tuple[BoardType, LimitsReport]:
        board_type, search = await ask(coordinator.board_type, name), services.searching.ask
        runs, _ = await search(coordinator.kept.history.find, RunFilter(board_type=name), _LATEST_RUNS, None)
        return board_type, await search(coordinator.parts.would_mark, board_type, limits, [run.id for run in runs])

    @routes.get("/{name}/revisions")
    async def list_revisions(name: BoardTypeName) -> BoardTypeVersions:
        """List the versions of a board type that were replaced or deleted, newest first."""
        return BoardTypeVersions(revisions=list(await ask(history.list, name)))

    @routes.get("/{name}/revisions/{revision}", response_model=BoardType)
    async def get_revision(name: BoardTypeName, revision: Revision) -> Response:
        """Return the document of one version."""
        return Response(document_of(await ask(history.get, name, revision)), media_type="application/json")

    @routes.post("/{name}/revisions/{revision}/restore", response_model=BoardType)
    async def restore_revision(
        request: Request, name: BoardTypeName, revision: Revision, _: IfMatch = None
    ) -> Response:
        """Put a version in force again, from the next arming on. The present one becomes a version itself.

        The reference and the method of a board type that was deleted have to be set again.
        """
        async with unchanged_board_type(services, request, name):
            return Response(document_of(await ask(history.restore, name, revision)), media_type="application/json")

    @routes.post("/{name}/program/check")
    async def check_light_program(name: BoardTypeName, body: ProgramRequest) -> ProgramCheck:
        """Check a light program as if the line were armed with it: all faults at once, each with its limit.

        Nothing is changed. The reply states all values of the steps, and the limits of cameras, lights and line.
        """
        board_type = await ask(coordinator.board_type, name)
        return await ask(coordinator.lighting.programs.check, board_type, body.program)

    _add_stitching(routes, services)
    routes.routes += _board_check(services).routes
    return routes


def _add_stitching(routes: APIRouter, services: Services) -> None:
    """Add the routes for reference and method of a board type. A change applies from the next arming on."""
    coordinator, ask = services.coordinator, services.commands.ask
    # Between the check of If-Match and the change no other caller may change the setting. Teaching copies frames.
    changing, teaching = asyncio.Lock(), asyncio.Lock()

    @asynccontextmanager
    async def unchanged(
        request: Request, lock: asyncio.Lock, read: Callable[[str], Setting], name: str, what: str
    ) -> AsyncIterator[None]:
        async with lock:
            present = await _present(services, request, lambda: _content(read(name)))
            require_unchanged(request, present, f"The {what} of {name!r}")
            yield

    unchanged_reference = partial(unchanged, lock=teaching, read=coordinator.reference, what="reference")
    unchanged_method = partial(unchanged, lock=changing, read=coordinator.method, what="method")

    @routes.get("/{name}/good")
    async def get_good_boards(name: BoardTypeName) -> GoodBoards:
        """Return the good boards with which the parts of later boards of this type are compared."""
        return await ask(coordinator.parts.good, name)

    @routes.get("/{name}/reference")
    async def get_reference(response: Response, name: BoardTypeName) -> ReferenceStatus:
        """Return the board type's reference, and whether it is usable. Replies 404 `no-reference` if there is none."""
        return _tagged(response, await ask(coordinator.reference, name))

    @routes.put(
        "/{name}/reference",
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
        teach = partial(coordinator.teach_reference, confirm_orientation=wanted.confirm_orientation)
        async with unchanged_reference(request, name=name):
            if await ask(teach, name, wanted.run):
                response.status_code, response.headers["Location"] = 201, quote(request.url.path)
            return _tagged(response, await ask(coordinator.reference, name))

    @routes.delete("/{name}/reference", status_code=204)
    async def forget_reference(request: Request, name: BoardTypeName, _: IfMatch = None) -> None:
        """Delete the reference of the board type. The change applies from the next arming on.

        With `If-Match: ETAG` only if it is still the one that the caller has read: else 412 `changed`.
        """
        async with unchanged_reference(request, name=name):
            await ask(coordinator.forget_reference, name)

    @routes.get("/{name}/method")
    async def get_method(response: Response, name: BoardTypeName) -> StitchingMethod:
        """Return the stitching method of the board type: the one that was set for it, else the station's default."""
        return _tagged(response, await ask(coordinator.method, name))

    @routes.put("/{name}/method")
    async def set_method(
        request: Request, response: Response, name: BoardTypeName, wanted: MethodRequest, _: IfMatch = None
    ) -> StitchingMethod:
        """Set the stitching method of the board type, from the next arming on.

        With `If-Match: ETAG` only if it is still the one that the caller has read: else 412 `changed`.
        """
        async with unchanged_method(request, name=name):
            return _tagged(response, await ask(coordinator.set_method, name, wanted.method))

    @routes.delete("/{name}/method")
    async def forget_method(
        request: Request, response: Response, name: BoardTypeName, _: IfMatch = None
    ) -> StitchingMethod:
        """Delete the method that was set for the board type. The default (`method` of station.toml) then applies."""
        async with unchanged_method(request, name=name):
            return _tagged(response, await ask(coordinator.set_method, name, None))


def _board_check(services: Services) -> APIRouter:
    """Create the routes of the check of a board type against a run, and of its correction."""
    routes = rest_router(tags=["board types"])
    coordinator, checks = services.coordinator, services.coordinator.mosaics.board_checks
    # A check takes a worker for seconds: one caller at a time, and none of the threads for pictures.
    checking = ThreadLimit(1)

    def stored(run: str, name: str | None) -> BoardType:
        return coordinator.board_type(name or checks.own_type(run))

    @routes.get("/runs/{run}/board-check", response_model=BoardCheck)
    async def check_board_type(request: Request, run: RunId, board_type: Checked = None) -> Response:
        """Lay a board type, as it is stored now, over a run: shift, rotation, mirror and scale of its components.

        The reply names components that do not look as if they were there, and proposes a corrected board type. It
        takes some seconds. 410: the frames are no longer in memory.
        """
        made = await checking.ask(lambda: checks.check(run, stored(run, board_type)))
        return json_response(request, made.report, REVALIDATE)

    @routes.get(
        "/runs/{run}/board-check/picture",
        response_class=Response,
        responses=file_reply("The picture.", "image/jpeg"),
        dependencies=[Depends(services.picture_seats.hold)],
    )
    async def get_board_check_picture(request: Request, run: RunId, board_type: Checked = None) -> Response:
        """Return the picture of the check: bodies where the run's C puts them (blue) and where they are (yellow).

        Components that do not look as if they were there are red.
        """
        made = await checking.ask(lambda: checks.check(run, stored(run, board_type)))
        return conditional_response(request, made.picture, "image/jpeg", cache=REVALIDATE)

    @routes.post("/board-types/{name}/correct", response_model=BoardType)
    async def correct_board_type(
        request: Request, name: BoardTypeName, body: CorrectionRequest, _: IfMatch = None
    ) -> Response:
        """Store the correction that the check against a run proposes, as a draft. The version before can be restored.

        409 `nothing-to-correct`: the check proposes none.
        """
        ask = services.commands.ask
        # The check takes seconds, so other changes do not wait for it. One that comes meanwhile is checked again.
        while True:
            before = await ask(coordinator.board_type, name)
            require_unchanged(request, document_of(before), f"Board type {name!r}")
            corrected = await checking.ask(checks.correct, body.run, before, body.revision)
            async with services.changing:
                if await ask(coordinator.board_type, name) == before:
                    await ask(coordinator.put_board_type, corrected)
                    break
        headers = {"Content-Location": quote(request.url.path.rpartition("/")[0])}
        return Response(document_of(corrected), media_type="application/json", headers=headers)

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


@asynccontextmanager
async def unchanged_board_type(services: Services, request: Request, name: str) -> AsyncIterator[None]:
    """Hold off other changes of board types; raise ChangedError unless this one is as the request's conditions say."""
    async with services.changing:
        present = await _present(services, request, lambda: document_of(services.coordinator.board_type(name)))
        require_unchanged(request, present, f"Board type {name!r}")
        yield


async def _present(services: Services, request: Request, document: Callable[[], bytes]) -> bytes | None:
    """Return a document as it is now; None if there is none, or the request has no condition."""
    if not {"if-match", "if-none-match"} & set(request.headers.keys()):
        return None
    try:
        return await services.commands.ask(document)
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


def _content(setting: StitchingMethod | ReferenceStatus) -> bytes:
    return setting.model_dump_json().encode()


def _tagged(response: Response, setting: Setting) -> Setting:
    """Add the ETag of a method or reference to its reply, and return it."""
    response.headers["ETag"] = tag_of(_content(setting))
    return setting
