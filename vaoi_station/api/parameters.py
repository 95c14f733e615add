"""Path and query parameters that several routes use, with their limits, and routers that refuse unclear ones."""

from __future__ import annotations

from enum import Enum
from typing import Annotated, Any, get_args, get_origin

from fastapi import APIRouter, Depends, Header, Path, Query, Request
from fastapi.routing import APIRoute
from pydantic import BaseModel, Field

from vaoi_station.api.fast.rest_route import RestRoute
from vaoi_station.errors import InputError
from vaoi_station.model.board_type import ONE_LINE, STORED_NAME

PREFIX = "/api/v1"

# Patterns refuse slashes and control characters here, before a name reaches a file path or a log.
RUN_ID = r"^[A-Za-z0-9][A-Za-z0-9._:-]{0,63}$"
RunId = Annotated[str, Path(description="Id of a run, as listed by `runs`.", pattern=RUN_ID)]
BoardTypeName = Annotated[
    str,
    Path(
        description="Name of a board type: no slashes, no leading dot, at most 80 characters.",
        pattern=STORED_NAME,
    ),
]
# Control characters would break the lines of logs and messages, and labels and other programs do not show them.
PLAIN_TEXT = r"^[^\x00-\x1f\x7f]*$"
PlainText = Annotated[str, Field(pattern=PLAIN_TEXT)]
"""A text in one line."""
# A code on a board may have the separators of ISO/IEC 15434 (EOT, FS, GS, RS, US), and its whole text may be the id.
CALLER_ID = r"^[^\x00-\x03\x05-\x1b\x7f]*$"
CallerId = Annotated[str, Field(pattern=CALLER_ID)]
"""An id of a board, as the caller states it or as a code on the board has it."""
REVISION = r"^([0-9]{8}T[0-9]{9}Z-[0-9a-f]{8}|latest)$"
Revision = Annotated[str, Path(description="Id of a version, as listed by `revisions`, or `latest`.", pattern=REVISION)]
PREVIEW_ID = r"^[0-9a-f]{16}$"
MOSAIC_NAME = r"^board(,[^/\x00-\x1f\x7f]{1,400})?$"
Camera = Annotated[int, Path(description="Camera, from 0.", ge=0, le=9999)]
Row = Annotated[int, Path(description="Row, from 0.", ge=0, le=99999)]
Address = Annotated[str, Path(description="Component: `ref`, or `panel/ref` on a panel.", min_length=1, max_length=200)]
PxPerMm = Annotated[
    float | None,
    Query(
        description="Resolution of the temporary images; default: the station's setting.",
        ge=0.5,
        le=500,
        allow_inf_nan=False,
    ),
]
MinCoverage = Annotated[
    float,
    Query(
        description="Omit frames that show less than this share of the component.",
        gt=0,
        le=1,
        allow_inf_nan=False,
    ),
]
FormatName = Annotated[
    str | None,
    Query(description="png, jpeg, tiff, npy or raw; has precedence over Accept.", max_length=20),
]
IfMatch = Annotated[
    str | None,
    Header(alias="If-Match", description="ETag of what the caller has read; else 412.", max_length=500),
]
IfNoneMatch = Annotated[
    str | None, Header(alias="If-None-Match", description="`*`: only if there is none; else 412.", max_length=500)
]
TimeoutS = Annotated[float, Query(description="Maximum wait, s.", alias="timeout", ge=0, le=60, allow_inf_nan=False)]


IN_WORDS = {
    RUN_ID: "must be the id of a run, as listed by runs",
    STORED_NAME: "must be the name of a board type, as listed by board-types: no slashes, no leading dot, at most "
    "80 characters",
    REVISION: "must be the id of a version, as listed by revisions of the board type, or latest",
    PREVIEW_ID: "must be the id of a preview, as listed by board-data/previews",
    MOSAIC_NAME: "must be the name of a mosaic, as listed by mosaics of the run",
    PLAIN_TEXT: "must have no control characters",
    ONE_LINE: "must have no control characters",
    CALLER_ID: "must have no control characters but the separators of ISO/IEC 15434",
}
"""What a text must be that does not match a pattern: callers do not read regular expressions."""
FOR_CACHES = "_"
"""Name of a query parameter without a meaning."""


def parse_box(name: str, text: str | None) -> tuple[float, float, float, float] | None:
    """Parse a parameter that states a box, `x0,y0,x1,y1`; None without one. Raise InputError unless it is 4 numbers."""
    if text is None:
        return None
    try:
        x0, y0, x1, y1 = map(float, text.split(","))
    except ValueError:
        limit = "four numbers x0,y0,x1,y1 in CAD coordinates"
        raise InputError.field("query", name, text, limit) from None
    return x0, y0, x1, y1


async def refuse_unclear_parameters(request: Request) -> None:
    """Raise InputError if the query has a parameter that the route does not have, or one value too many.

    An ignored parameter would give an answer to another question: `runs?verdict=failed` would list all runs, and of
    `verdict=ok&verdict=failed` only the last would count. `_` is ignored everywhere: pages and libraries add it to
    keep caches from giving an older answer.
    """
    route = request.scope.get("route")
    if not request.query_params or not isinstance(route, APIRoute) or not route.include_in_schema:
        return
    known = _query_parameters(route)
    for name in request.query_params:
        if name not in known and name != FOR_CACHES:
            offer = f"it has {', '.join(sorted(known))}" if known else "it has none"
            raise InputError(
                f"query: {name!r} is no parameter of {request.method} {request.url.path}; {offer}.",
                action="Correct or remove the parameter.",
                code="unknown-parameter",
            )
        count = len(request.query_params.getlist(name))
        if count > 1 and not known.get(name, True):
            raise InputError(
                f"query: {name!r} is given {count} times, but {request.method} {request.url.path} takes one value.",
                action="Send the parameter once.",
                code="repeated-parameter",
            )


def _query_parameters(route: APIRoute) -> dict[str, bool]:
    """Return the names of the query parameters of a route and its dependencies, and whether each may be repeated."""
    # The OpenAPI document states the same names, but to generate it delayed the first request by 0.3 s.
    found, left = dict[str, bool](), [route.dependant]
    while left:
        dependant = left.pop()
        left += dependant.dependencies
        for field in dependant.query_params:
            model = field.field_info.annotation
            if isinstance(model, type) and issubclass(model, BaseModel):  # one parameter per field of the model
                found |= {own.alias or name: _is_list(own.annotation) for name, own in model.model_fields.items()}
            else:
                found[field.alias] = _is_list(model)
    return found


def _is_list(annotation: object) -> bool:
    """Return whether values of a type are lists, also if there may be none: `list[X] | None`."""
    return any(get_origin(kind) is list for kind in (annotation, *get_args(annotation)))


def file_reply(description: str, *media: str) -> dict[int | str, dict[str, Any]]:
    """Return the OpenAPI description of a reply that is a file of one of these media types."""
    binary = {"schema": {"type": "string", "format": "binary"}}
    return {200: {"description": description, "content": dict.fromkeys(media, binary)}}


def rest_router(prefix: str = "", tags: list[str | Enum] | None = None, base: str = PREFIX) -> APIRouter:
    """Return a router whose routes are complete, with address, checks and name: the application takes them as they are.

    `FastAPI.include_router` would add all this too, but it builds each route anew, which takes as long as the first
    time.
    """
    checks = [Depends(refuse_unclear_parameters)]
    return APIRouter(
        prefix=base + prefix,
        tags=tags,
        dependencies=checks,
        generate_unique_id_function=operation_id,
        route_class=RestRoute,
    )


def operation_id(route: APIRoute) -> str:
    """Return the handler's name, which generated clients use as a method name."""
    return route.name
