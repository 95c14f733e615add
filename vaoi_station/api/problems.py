"""Problem details (RFC 9457): every refusal has the same JSON schema, with cause and action.

`type` is the relative reference `/problems/KIND`, below the prefix of a proxy if there is one, under which the station
serves an explanation. `code` equals the kind or is more specific (kind `gone`, code `frames-gone`); both are stable.
`detail` names field, value and limit; `action` is a sentence that the operator can follow.
"""

from __future__ import annotations

import logging
import uuid
from collections.abc import Mapping
from http import HTTPStatus
from typing import Any
from urllib.parse import quote

from fastapi import FastAPI, Request
from fastapi.exceptions import RequestValidationError
from fastapi.responses import JSONResponse
from pydantic import BaseModel, Field
from starlette.exceptions import HTTPException
from starlette.routing import Match, Mount
from starlette.types import Scope

from vaoi_station.api.addresses import path_of, root_of
from vaoi_station.api.parameters import IN_WORDS
from vaoi_station.errors import VaoiError

MEDIA_TYPE = "application/problem+json"
STREAM = "/api/v1/events"
"""Path of the event stream, whose reply has no end."""
SAFE = ("GET", "HEAD", "OPTIONS")
log = logging.getLogger(__name__)


class Fault(BaseModel):
    """One invalid field of a request."""

    where: str
    """Part of the request, and path of the field in it: for example `query.timeout`, `body.components.3.width`."""
    message: str


class Problem(BaseModel):
    """A refusal as a problem detail (RFC 9457)."""

    type: str
    title: str
    status: int
    detail: str
    code: str
    action: str = Field(description="What the operator can do.")
    instance: str = Field(description="Path of the request.")
    errors: list[Fault] | None = Field(default=None, description="Invalid fields, if any.")


KINDS: dict[str, tuple[int, str, str]] = {
    "invalid-input": (422, "Invalid value", "Correct the named field and send the request again."),
    "malformed": (400, "Unreadable request", "Send a JSON object, or no body where it is optional."),
    "no-key": (
        401,
        "Key required",
        'Send a key as "Authorization: Bearer KEY", or log in on the page; vaoi keys makes one.',
    ),
    "missing-scope": (403, "Not permitted with this key", "Use a key with this scope; see vaoi keys list."),
    "foreign-origin": (
        403,
        "Command from another site",
        "Use the station's own page, or send the command from a program.",
    ),
    "unknown-host": (
        421,
        "Unknown host name",
        "Use the station's IP address, or add the name to [api] names in station.toml.",
    ),
    "too-slow": (408, "Request time-out", "Send the request again over a faster connection."),
    "not-found": (404, "Not found", "Check the names and numbers in the address; the detail says which is unknown."),
    "no-route": (404, "Unknown address", "Check the address; /docs lists all addresses."),
    "wrong-method": (405, "Method not allowed", "Use a method from the Allow header."),
    "not-acceptable": (406, "Format not available", "Request one of the listed formats, by Accept or ?format=."),
    "wrong-state": (409, "Not possible in the present state", "Wait until the station's state allows it."),
    "gone": (
        410,
        "No longer kept",
        "Fetch images sooner, hold or pin the run, or increase [ring] runs in station.toml.",
    ),
    "changed": (412, "Changed meanwhile", "Read it again, then make the change to what is there now."),
    "too-large": (413, "Request too large", "Send a smaller body; the detail names the limit."),
    "range-not-satisfiable": (416, "No such bytes", "Ask for a range within the size that Content-Range states."),
    "internal": (
        500,
        "Internal error",
        "Try again; if the error persists, report the incident number to the maintainer.",
    ),
    "device": (503, "Device fault", "Check the device, its cable and its power supply."),
    "busy": (503, "Busy", "Try again in a moment."),
}
"""For each kind of problem: HTTP status, title, and the default action."""
_CODE_OF_STATUS = {400: "malformed", 404: "no-route", 405: "wrong-method", 406: "not-acceptable", 413: "too-large"}
_KIND_OF_STATUS = {
    404: "not-found",
    409: "wrong-state",
    410: "gone",
    412: "changed",
    422: "invalid-input",
    503: "busy",
    500: "internal",
}


class NotAcceptableError(VaoiError):
    """The station offers none of the formats that the client accepts."""

    code = "not-acceptable"
    status = 406


def problem_response(
    scope: Scope,
    code: str,
    detail: str,
    *,
    status: int | None = None,
    action: str = "",
    errors: list[Fault] | None = None,
    headers: Mapping[str, str] | None = None,
) -> JSONResponse:
    """Return the reply to a refused request. If `code` is not one of the `KINDS`, `status` determines the kind."""
    kind = code if code in KINDS else _KIND_OF_STATUS.get(status or 500, "internal")
    usual_status, title, remedy = KINDS[kind]
    problem = Problem(
        type=f"{root_of(scope)}/problems/{kind}",
        title=title,
        status=status or usual_status,
        detail=detail,
        code=code,
        action=action or remedy,
        instance=quote(scope["path"]),
        errors=errors,
    )
    extra = {"Cache-Control": "no-store", **(headers or {})}
    if problem.status == HTTPStatus.SERVICE_UNAVAILABLE:
        # Clients that retry automatically wait for this number of seconds (RFC 9110, section 10.2.3).
        extra.setdefault("Retry-After", "1")
    content = problem.model_dump(mode="json", exclude_none=True)
    return JSONResponse(content, problem.status, headers=extra, media_type=MEDIA_TYPE)


def install(app: FastAPI) -> None:
    """Make the application reply with a problem to every error: of the station, of FastAPI, or unexpected."""
    app.add_exception_handler(VaoiError, _refusal)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(HTTPException, _http)
    app.add_exception_handler(Exception, _unexpected)


async def _refusal(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, VaoiError)
    if error.status >= HTTPStatus.INTERNAL_SERVER_ERROR and error.code == "internal":
        log.error("%s %s: %s", request.method, request.url.path, error, exc_info=error)
    return problem_response(request.scope, error.code, error.message, status=error.status, action=error.action)


async def _invalid(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    found = error.errors()
    # A wrong array may have thousands of faults; the first ones are enough to correct it.
    faults = [_fault(fault) for fault in found[:20]]
    code = "malformed" if any(fault["type"] == "json_invalid" for fault in found) else "invalid-input"
    more = f"; and {len(found) - 3} more" if len(found) > 3 else ""
    detail = "; ".join(f"{fault.where}: {fault.message}" for fault in faults[:3]) + more
    return problem_response(request.scope, code, f"{detail}.", errors=faults)


def _fault(fault: Mapping[str, Any]) -> Fault:
    message = str(fault["msg"]).removeprefix("Value error, ")
    if fault["type"] == "json_invalid":
        message = f"is not valid JSON ({fault.get('ctx', {}).get('error', message)})"
    if fault["type"] == "string_pattern_mismatch":
        message = IN_WORDS.get(fault["ctx"]["pattern"], message)
    given = fault.get("input")
    if isinstance(given, str | int | float | bool) and fault["type"] != "missing":
        message += f" (given: {given!r:.80})"
    return Fault(where=".".join(map(str, fault["loc"])), message=message)


async def _http(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)
    path, code = request.url.path, _CODE_OF_STATUS.get(error.status_code, "internal")
    detail, headers = str(error.detail), error.headers
    if code == "no-route":
        detail = f"{path} does not exist."
    elif code == "wrong-method":
        allow = ", ".join(allowed_methods(request))
        detail, headers = f"{path} does not take {request.method}, only {allow}.", {"Allow": allow}
    return problem_response(request.scope, code, detail, status=error.status_code, headers=headers)


def allowed_methods(request: Request) -> list[str]:
    """Return all methods that the address of a request takes, sorted."""
    # Starlette names the methods of one route, but each method of an address has a route of its own.
    address = {"type": "http", "path": request.scope["path"], "root_path": root_of(request.scope)}
    found = {
        method
        for method in ("GET", "POST", "PUT", "PATCH", "DELETE")
        for route in request.app.routes
        # A mounted folder matches every method; its files are only read.
        if route.matches({**address, "method": method})[0] is Match.FULL
        and (method == "GET" or not isinstance(route, Mount))
    }
    # HEAD is passed on as GET, except for the event stream, which has no end.
    return sorted(found | {"HEAD"} if "GET" in found and path_of(request.scope) != STREAM else found)


async def _unexpected(request: Request, error: Exception) -> JSONResponse:
    # The reply does not show the exception, which may name internal paths; the number leads to it in the log.
    incident = uuid.uuid4().hex[:12]
    log.error("incident %s: %s %s", incident, request.method, request.url.path, exc_info=error)
    detail = f"The request could not be completed. Incident {incident} is in the station's log."
    return problem_response(request.scope, "internal", detail)
