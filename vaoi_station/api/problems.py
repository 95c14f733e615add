"""Problem details (RFC 9457): every refusal says what happened, and what to do, in one JSON shape.

`type` is a relative reference `/problems/KIND`, which the station answers with an explanation. `code` says the same
or more (kind `gone`, code `frames-gone`) and is stable for programs too; `detail` names field, value and limit,
`action` is a sentence the operator can follow.
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

from vaoi_station.errors import VaoiError

MEDIA_TYPE = "application/problem+json"
log = logging.getLogger(__name__)


class Fault(BaseModel):
    """One field that is wrong."""

    where: str
    """Part of the request and path of the field: `query.timeout`, `body.components.3.width`."""
    message: str


class Problem(BaseModel):
    """Why a request was refused, after RFC 9457."""

    type: str
    title: str
    status: int
    detail: str
    code: str
    action: str = Field(description="A sentence the operator can follow.")
    instance: str = Field(description="The address that was asked for.")
    errors: list[Fault] | None = Field(default=None, description="Each field that is wrong; only where fields are.")


KINDS: dict[str, tuple[int, str, str]] = {
    "invalid-input": (422, "A value is not acceptable", "Correct the field that is named, and send the request again."),
    "malformed": (400, "The request cannot be read", "Send a JSON object, or leave the body out where it is optional."),
    "foreign-origin": (
        403,
        "Another site's page sent this command",
        "Open the station's own page, or send the command from a program.",
    ),
    "unknown-host": (
        421,
        "Another name than this station's was called",
        "Call the station by its address, or add the name to [api] names in station.toml.",
    ),
    "too-slow": (408, "The request took too long to arrive", "Send it again over a better connection."),
    "not-found": (404, "There is no such thing", "Check the address; lists are at /api/v1/runs and board-types."),
    "no-route": (404, "There is no such address", "Check the address; all addresses are listed at /docs."),
    "wrong-method": (405, "The address does not take this method", "Use a method that the header Allow names."),
    "not-acceptable": (406, "No such format", "Ask for a format of the offer, by Accept or by ?format=."),
    "wrong-state": (409, "Not possible in the present state", "Wait until the state of the station allows it."),
    "gone": (
        410,
        "Its memory has been given away",
        "Fetch pictures sooner, hold the run meanwhile, or give the ring room for more runs in station.toml.",
    ),
    "too-large": (413, "The request is too large", "Send less; the limit is in the detail."),
    "internal": (
        500,
        "The station made a mistake",
        "Try again; if it stays, give the incident number to whoever maintains the station.",
    ),
    "device": (503, "A device does not do what it should", "Check the device, its cable and its supply."),
    "busy": (503, "Too much at once", "Try again in a moment."),
}
"""Kind → status, title, and the action of a refusal that names none itself."""

_CODE_OF_STATUS = {400: "malformed", 404: "no-route", 405: "wrong-method", 406: "not-acceptable", 413: "too-large"}
_KIND_OF_STATUS = {
    404: "not-found",
    409: "wrong-state",
    410: "gone",
    422: "invalid-input",
    503: "busy",
    500: "internal",
}


class NotAcceptableError(VaoiError):
    """None of the formats the caller accepts is offered."""

    code = "not-acceptable"
    status = 406


def problem_response(
    request_path: str,
    code: str,
    detail: str,
    *,
    status: int | None = None,
    action: str = "",
    errors: list[Fault] | None = None,
    headers: Mapping[str, str] | None = None,
) -> JSONResponse:
    """The answer to a refused request; a code that is no kind itself is of the kind its status says."""
    kind = code if code in KINDS else _KIND_OF_STATUS.get(status or 500, "internal")
    usual_status, title, remedy = KINDS[kind]
    problem = Problem(
        type=f"/problems/{kind}",
        title=title,
        status=status or usual_status,
        detail=detail,
        code=code,
        action=action or remedy,
        instance=quote(request_path),
        errors=errors,
    )
    extra = {"Cache-Control": "no-store", **(headers or {})}
    if problem.status == HTTPStatus.SERVICE_UNAVAILABLE:
        extra.setdefault("Retry-After", "1")
    content = problem.model_dump(mode="json", exclude_none=True)
    return JSONResponse(content, problem.status, headers=extra, media_type=MEDIA_TYPE)


def install(app: FastAPI) -> None:
    """Make every error of the app a problem: ours, those of the framework, and those nobody foresaw."""
    app.add_exception_handler(VaoiError, _refusal)
    app.add_exception_handler(RequestValidationError, _invalid)
    app.add_exception_handler(HTTPException, _http)
    app.add_exception_handler(Exception, _unforeseen)


async def _refusal(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, VaoiError)
    if error.status >= HTTPStatus.INTERNAL_SERVER_ERROR and error.code == "internal":
        log.error("%s %s: %s", request.method, request.url.path, error, exc_info=error)
    return problem_response(request.url.path, error.code, error.message, status=error.status, action=error.action)


async def _invalid(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, RequestValidationError)
    faults = [_fault(f) for f in error.errors()[:20]]
    code = "malformed" if any(f["type"] == "json_invalid" for f in error.errors()) else "invalid-input"
    detail = "; ".join(f"{f.where}: {f.message}" for f in faults[:3])
    if len(error.errors()) > 3:
        detail += f"; and {len(error.errors()) - 3} more"
    return problem_response(request.url.path, code, detail + ".", errors=faults)


def _fault(fault: Mapping[str, Any]) -> Fault:
    message = str(fault["msg"]).removeprefix("Value error, ")
    if fault["type"] == "json_invalid":
        message = f"is not valid JSON ({fault.get('ctx', {}).get('error', message)})"
    given = fault.get("input")
    if isinstance(given, str | int | float | bool) and fault["type"] != "missing":
        message += f" (given: {given!r:.80})"
    return Fault(where=".".join(map(str, fault["loc"])), message=message)


async def _http(request: Request, error: Exception) -> JSONResponse:
    assert isinstance(error, HTTPException)
    path, code = request.url.path, _CODE_OF_STATUS.get(error.status_code, "internal")
    allow = (error.headers or {}).get("Allow", "")
    detail = {
        "no-route": f"{path} does not exist.",
        "wrong-method": f"{path} does not take {request.method}, only {allow}.",
    }.get(code, str(error.detail))
    return problem_response(path, code, detail, status=error.status_code, headers=error.headers)


async def _unforeseen(request: Request, error: Exception) -> JSONResponse:
    incident = uuid.uuid4().hex[:12]
    log.error("incident %s: %s %s", incident, request.method, request.url.path, exc_info=error)
    detail = f"The request could not be completed. Incident {incident} is in the station's log."
    return problem_response(request.url.path, "internal", detail)
