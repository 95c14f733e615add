"""Path and query parameters that several routes use, with their limits, and the routes that read them."""

from __future__ import annotations

from collections.abc import Callable, Coroutine
from enum import Enum
from typing import Annotated, Any, get_args, get_origin

from fastapi import APIRouter, Depends, Header, Path, Query, Request, Response
from fastapi.routing import APIRoute
from pydantic import AwareDatetime, BaseModel
from starlette.routing import Match
from starlette.types import Scope

from vaoi_station.api.addresses import path_of
from vaoi_station.api.http_caching import LIVE
from vaoi_station.api.rest_models import CALLER_ID, PLAIN_TEXT, PREVIEW_ID
from vaoi_station.errors import InputError
from vaoi_station.model.board_type import ONE_LINE, STORED_NAME

PREFIX = "/api/v1"
FOR_CACHES = "_"
"""Name of a query parameter without a meaning, which pages and libraries add to keep caches from an older answer."""

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
REVISION = r"^([0-9]{8}T[0-9]{9}Z-[0-9a-f]{8}|latest)$"
Revision = Annotated[str, Path(description="Id of a version, as listed by `revisions`, or `latest`.", pattern=REVISION)]
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
FormatName = Annotated[
    str | None, Query(description="png, jpeg, tiff, npy or raw; has precedence over Accept.", max_length=20)
]
IfMatch = Annotated[
    str | None, Header(alias="If-Match", description="ETag of what the caller has read; else 412.", max_length=500)
]
IfNoneMatch = Annotated[
    str | None, Header(alias="If-None-Match", description="`*`: only if there is none; else 412.", max_length=500)
]
TimeoutS = Annotated[float, Query(description="Maximum wait, s.", alias="timeout", ge=0, le=60, allow_inf_nan=False)]
Moment = Annotated[AwareDatetime | None, Query(description="A time with its zone, RFC 3339.")]

_NO_CONTROL = "must have no control characters"
IN_WORDS = {
    RUN_ID: "must be the id of a run, as listed by runs",
    STORED_NAME: "must be the name of a board type, as listed by board-types: no slashes, no leading dot, at most "
    "80 characters",
    REVISION: "must be the id of a version, as listed by revisions of the board type, or latest",
    PREVIEW_ID: "must be the id of a preview, as listed by board-data/previews",
    MOSAIC_NAME: "must be the name of a mosaic, as listed by mosaics of the run",
    PLAIN_TEXT: _NO_CONTROL,
    ONE_LINE: _NO_CONTROL,
    CALLER_ID: f"{_NO_CONTROL} but the separators of ISO/IEC 15434",
}
"""What a text must be that does not match a pattern: callers do not read regular expressions."""


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
    `verdict=ok&verdict=failed` only the last would count.
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


class RestRoute(APIRoute):
    """A route whose replies leave fields without a value out, and are not cached unless they say so."""

    def __init__(self, *args: Any, **options: Any) -> None:
        super().__init__(*args, **{**options, "response_model_exclude_none": True})

    def get_route_handler(self) -> Callable[[Request], Coroutine[Any, Any, Response]]:
        """Return the handler of FastAPI, whose replies get the default for caches."""
        handle = super().get_route_handler()

        async def handled(request: Request) -> Response:
            response = await handle(request)
            if response.status_code != 204:
                response.headers.setdefault("Cache-Control", LIVE)
            return response

        return handled

    def matches(self, scope: Scope) -> tuple[Match, Scope]:
        """Compare the path first: a request is tried by some forty routes, which read more before they compare it."""
        path = path_of(scope) if scope.get("root_path") else scope["path"]
        other = self.path_regex.match(path) is None
        return (Match.NONE, {}) if other else super().matches(scope)


class RouteWithoutQuery(RestRoute):
    """A route for requests without a query; the route for the others follows it, and describes both.

    FastAPI reads each query parameter of a route in every request. For the 19 of a picture this takes as long as the
    rest of the request, and a tester mostly sends none of them.
    """

    def matches(self, scope: Scope) -> tuple[Match, Scope]:
        """Match a request without a query as other routes do, and no other request."""
        return (Match.NONE, {}) if scope.get("query_string") else super().matches(scope)


def rest_router(prefix: str = "", tags: list[str | Enum] | None = None, base: str = PREFIX) -> APIRouter:
    """Return a router whose routes are complete, with address, checks and name: the application takes them as they are.

    `FastAPI.include_router` would add all this too, but it builds each route anew, which takes as long as the first
    time.
    """
    return APIRouter(
        prefix=base + prefix,
        tags=tags,
        dependencies=[Depends(refuse_unclear_parameters)],
        generate_unique_id_function=operation_id,
        route_class=RestRoute,
    )


def operation_id(route: APIRoute) -> str:
    """Return the handler's name, which generated clients use as a method name."""
    return route.name
